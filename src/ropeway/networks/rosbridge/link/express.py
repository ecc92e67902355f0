"""A second connection beside a link, for the topics whose messages are small.

On one connection a command waits for the images before it: in TCP for what was lost of them and is sent again, and
always for the part that is being sent. So two Ropeway gateways use two connections. The listening one names a secret in
its ``hello``; the one that dialled shows it in the header ``Ropeway-Express`` of a second handshake, with the same
credentials. A topic goes by the second connection while its messages are small, and leaves it for good with the first
large one. Before a topic changes its connection, everything that it sent on the old one has arrived: a ``ping`` goes
after it, and nothing of the topic is sent until the ``pong`` is there. So the order within a topic holds. What the peer
has asked for begins on the second connection at once.

The second connection is an improvement on which nothing depends: if it cannot be opened, or is lost, everything
continues on the first. The last messages are then sent again, since nobody knows whether they arrived; receivers drop
duplicates.
"""

from __future__ import annotations

import asyncio
import hmac
import secrets
import time
from collections import deque
from collections.abc import Mapping, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, Final, Protocol

from ropeway.errors import WireError
from ropeway.networks.rosbridge.link.channel import Channel, Outgoing, Stream, StreamSender
from ropeway.networks.rosbridge.link.sender import RecordSender
from ropeway.networks.rosbridge.protocol.records import RecordReader

if TYPE_CHECKING:
    from ropeway.fault_log import FaultLog
    from ropeway.listener.connection import Connection
    from ropeway.networks.rosbridge.protocol.dialect import Dialect

__all__ = ["HEADER", "Express"]

HEADER: Final = "Ropeway-Express"
"""The header of the second handshake; its value is the secret that ``hello`` named."""

_FENCE_S: Final = 2.0  # a pong that takes longer is not waited for: the topic goes on
_REMEMBERED: Final = 128  # messages: as many as a lost one holds up, and more


class _ExpressSender(RecordSender):
    """Sends on the second connection, and remembers what it sent last."""

    second = True

    def __init__(self, connection: Connection, fault_log: FaultLog, dialect: Dialect) -> None:
        super().__init__(connection, fault_log, dialect)
        self.recent = deque(maxlen=_REMEMBERED)


class ExpressPeer(Protocol):
    """Gives a second connection the part of its peer that it may use."""

    dialect: Dialect
    fault_log: FaultLog

    @property
    def sender(self) -> StreamSender:
        """Return the sender of the first connection."""
        ...

    @property
    def limit_bytes(self) -> int:
        """Return how large a message may be."""
        ...

    def refused(self, channel: int, error: WireError) -> None:
        """Note a message of a channel that is refused."""
        ...

    def takes(self, channel: int) -> bool:
        """Return whether somebody reads a channel."""
        ...

    def take_text(self, data: bytes) -> None:
        """Take a text that came."""
        ...

    def take_records(self, reader: RecordReader, data: bytes | memoryview) -> None:
        """Take records that came."""
        ...


class Express:
    """The second connection of one peer, if there is one, and which topics take it."""

    def __init__(self, peer: ExpressPeer) -> None:
        self._peer = peer
        self.offered = ""
        """The secret that the peer's ``hello`` named."""
        self._secret = ""
        self._connection: Connection | None = None
        self._sender: _ExpressSender | None = None
        self._fences: dict[int, tuple[Stream[Any], asyncio.TimerHandle, Sequence[Outgoing]]] = {}
        self._marks: dict[int, asyncio.Future[None]] = {}

    @property
    def open(self) -> bool:
        """Return whether the second connection stands."""
        return self._sender is not None

    @property
    def connection(self) -> Connection | None:
        """The second connection, if it stands."""
        return self._connection

    def offer(self) -> str:
        """Make the secret that lets the peer open the second connection."""
        self._secret = self._secret or secrets.token_hex(16)
        return self._secret

    def knows(self, secret: str) -> bool:
        """Return whether this is the secret that was offered."""
        return bool(self._secret) and hmac.compare_digest(secret.encode(), self._secret.encode())

    def attach(self, connection: Connection) -> None:
        """Use a second connection; one that stands already is replaced."""
        if self._connection is not None:
            self._connection.close(1000, "replaced")
            self._detach()
        peer = self._peer
        self._connection = connection
        self._sender = sender = _ExpressSender(connection, peer.fault_log, peer.dialect)
        reader = RecordReader(peer.limit_bytes, peer.refused, peer.takes)
        connection.on_text = peer.take_text
        connection.on_binary = partial(peer.take_records, reader)
        connection.on_writable = sender.pump
        connection.on_closed = lambda code, reason: self._lost(connection)
        connection.account.hold("messages in parts", lambda: reader.pending_bytes)
        connection.account.hold("queues", lambda: sender.outbox.bytes)

    def close(self) -> None:
        """Close the second connection: the link is gone."""
        connection = self._connection
        if connection is not None:
            self._connection = None
            if self._sender is not None:
                self._sender.close()
                self._sender = None
            connection.close(1000, "the link has closed")
        for _, timer, _ in self._fences.values():
            timer.cancel()
        self._fences.clear()
        self._reach_marks()

    def place(self, channel: Channel) -> None:
        """Choose the connection of a topic for messages such as the one that is about to wait."""
        if channel.large:
            if channel.sender is not self._peer.sender:
                self._move(channel, self._peer.sender)
        elif self._sender is not None and channel.sender is not self._sender:
            self._move(channel, self._sender)

    def arrived(self, pong: Mapping[str, Any]) -> bool:
        """Take a ``pong``; return whether a topic waited for it."""
        key = pong.get("t")
        if not isinstance(key, int):
            return False
        mark = self._marks.pop(key, None)
        if mark is not None:
            if not mark.done():
                mark.set_result(None)
            return True
        if key not in self._fences:
            return False
        self._pass(key)
        return True

    def mark(self, channel: Channel) -> asyncio.Future[None] | None:
        """Return what is done once all that a topic has sent on the second connection has arrived, or that is lost.

        ``None`` where the topic goes by the first connection, on which the next operation arrives after it anyway.
        """
        if self._connection is None or channel.sender is not self._sender:
            return None
        reached: asyncio.Future[None] = asyncio.get_running_loop().create_future()
        self._marks[self._ping(self._connection)] = reached
        return reached

    def _reach_marks(self) -> None:
        """Let nobody wait for marks on a connection that is gone."""
        for reached in self._marks.values():
            if not reached.done():
                reached.set_result(None)
        self._marks.clear()

    def _ping(self, connection: Connection) -> int:
        """Send a ping behind all that was sent on a connection; return what its pong will say."""
        key = time.time_ns()
        while key in self._fences or key in self._marks:
            key += 1
        connection.send_text(b'{"op":"ping","t":%d}' % key)
        return key

    def _move(self, channel: Channel, to: StreamSender) -> None:
        queue, old = channel.queue, channel.sender
        back = queue.held and self._call_off(channel)
        if queue.under_way and not back:
            return  # a message is being sent: at the next one
        waiting = old.outbox.release(queue)
        old.channels.pop(channel.number, None)
        channel.sender = to
        to.channels[channel.number] = channel
        to.outbox.adopt(queue, waiting)
        if back or old.connection.closed or (channel.asked and not channel.sent):
            self._go_on(channel)
        else:  # also for what was never sent: that there is such a topic has to arrive first
            self._fence(old.connection, channel)

    def _call_off(self, channel: Channel) -> bool:
        """Let a topic that waits for a pong go back: nothing of it was sent on the new connection."""
        key = next((key for key, (other, _, again) in self._fences.items() if other is channel and not again), None)
        if key is None:
            return False
        self._fences.pop(key)[1].cancel()
        channel.sender.outbox.done(channel.queue)
        return True

    @staticmethod
    def _go_on(channel: Stream[Any]) -> None:
        channel.sender.outbox.done(channel.queue)
        channel.sender.wake()

    def _fence(self, connection: Connection, channel: Stream[Any], again: Sequence[Outgoing] = ()) -> None:
        """Let a topic go on when everything that was sent on a connection has arrived, or after a while.

        What it is to send ``again`` goes first; it is not lost if the link is gone before.
        """
        key = self._ping(connection)
        timer = asyncio.get_running_loop().call_later(_FENCE_S, self._pass, key)
        self._fences[key] = (channel, timer, again)

    def _pass(self, key: int) -> None:
        channel, timer, again = self._fences.pop(key)
        timer.cancel()
        if again and channel.queue.held:
            channel.sender.outbox.put_back(channel.queue, again)
        self._go_on(channel)

    def _lost(self, connection: Connection) -> None:
        if connection is self._connection:
            self._detach()

    def _detach(self) -> None:
        """Continue with the first connection alone."""
        express, self._sender, self._connection = self._sender, None, None
        if express is None:
            return
        self._reach_marks()
        for key in list(self._fences):  # no pong comes by a connection that is gone
            self._pass(key)
        main = self._peer.sender
        recent: dict[Stream[Any], list[Outgoing]] = {}
        for channel, sample in express.recent or ():
            recent.setdefault(channel, []).append(sample)
        for channel in list(express.channels.values()):
            express.withdraw(channel)
            waiting = express.outbox.release(channel.queue)
            channel.sender = main
            main.channels[channel.number] = channel
            main.outbox.adopt(channel.queue, waiting)
            self._fence(main.connection, channel, recent.get(channel, ()))
        express.channels.clear()
        express.close()
