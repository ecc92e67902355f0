"""Implements a WebSocket connection, in either role, over picows.

A ``Connection`` delivers whole messages (continuation frames joined, bounded), tells when it can take more
(``writable``), notices a dead peer, and closes with a code and a reason. What the bytes mean is not its concern.
"""

from __future__ import annotations

import asyncio
import logging
import struct
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any, Final

from picows import WSCloseCode, WSFrame, WSListener, WSMsgType, WSTransport

from ropeway.budget import Budget
from ropeway.delivery.pacing.flow import Flow
from ropeway.delivery.pacing.tcp import tcp_info
from ropeway.limits import UNREAD_S, UNREAD_STATUS_BYTES
from ropeway.listener.http import HttpRequest
from ropeway.tasks import describe

__all__ = ["Connection", "Limits", "peer_address"]

log = logging.getLogger("ropeway.link")


_LOOKS_PER_PING: Final = 4


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of a connection.

    ``max_message_bytes``: inbound; more closes with 1009 (64 MiB carries a 60 MB point cloud).
    ``ping_interval_s``: a ping is sent this long after the last one; ``silence_s``: the peer is given up after so
    long without a byte (the two defaults notice a cut within 5 s). ``None`` turns the watch off.
    ``budget`` bounds what this connection and all others that share it may have us hold.
    """

    max_message_bytes: int = 64 << 20
    ping_interval_s: float | None = 1.0
    silence_s: float | None = 4.0
    open_timeout_s: float = 5.0
    budget: Budget = field(default_factory=Budget, compare=False)


_LARGE_BYTES: Final = 1 << 16  # a frame of which a copy costs more than a list of two parts
_LARGE_FRAME: Final = struct.Struct(">BBQ")  # the head of a frame whose size takes 64 bits, as all of this size
_FINAL_BINARY: Final = 0x82
_LENGTH_FOLLOWS: Final = 127
_AGENT_CHARACTERS: Final = 200  # of what a client calls itself


class Connection(WSListener):
    """A WebSocket connection.

    Set ``on_text``, ``on_binary``, ``on_writable`` and ``on_closed`` before the first await after it was made.
    ``peer`` is the address of the other side, ``subprotocol`` what both agreed on; ``server`` and ``dated`` tell what
    the answer of a server gave as its name, and whether it gave a date. On the server's side ``handshake`` is the
    request that the client began with, and ``grant`` what whoever admitted it wants to remember.
    """

    def __init__(self, limits: Limits, *, peer: str = "") -> None:
        self.limits = limits
        self.silence_s = limits.silence_s
        self.ping_interval_s = limits.ping_interval_s
        self.peer = peer
        self.subprotocol = ""
        self.server = ""
        self.dated = False
        self.flow = Flow(self._on_free)
        self.on_connected: Callable[[], None] = _nothing
        self.on_text: Callable[[bytes], None] = _ignore
        self.on_binary: Callable[[bytes | memoryview], None] = _ignore
        self.on_writable: Callable[[], None] = _nothing
        self.on_closed: Callable[[int, str], None] = _ignore_close
        self.on_look: Callable[[], None] = _nothing
        self.bytes_in = self.bytes_out = self.frames_in = self.frames_out = 0
        self.since_s = time.time()
        self.secure = False
        self.handshake: HttpRequest | None = None
        self.grant: object = None
        self._transport: WSTransport | None = None
        self._socket: Any = None
        self._unfinished: bytearray | None = None  # a message in continuation frames, as far as it came
        self._unfinished_text = False
        self._heard_before_frame = 0  # what the operating system had received when no message was half here
        self._frames_seen = 0
        self._taken_bytes = 0  # what the operating system had taken when it took something last …
        self._taken_s = time.monotonic()  # … and when that was
        self.account = limits.budget.open(self._ended_by_budget)
        self._pong: bytes | None = None  # the answer to the last ping, which waits until the link takes it
        self._reading = True
        self._last_heard = time.monotonic()
        self._heard_bytes = 0
        self._watch: asyncio.Task[None] | None = None
        self._close_code, self._close_reason = 1006, "the connection was lost"
        self.closed = False  # nothing can be sent or received any more
        self._closed = asyncio.Event()
        self._closing: asyncio.TimerHandle | None = None

    def status(self) -> dict[str, Any]:
        """Return who is on the other side, since when, and how many bytes went both ways, as JSON.

        ``agent`` is what the client calls itself, ``""`` where it does not.
        """
        headers = {} if self.handshake is None else self.handshake.headers
        return {
            "peer": self.peer,
            "since": round(self.since_s, 3),
            "agent": headers.get("user-agent", "")[:_AGENT_CHARACTERS],
            "bytes_in": self.bytes_in,
            "bytes_out": self.bytes_out,
        }

    # ── sending ────────────────────────────────────────────────────────────────────────────────────────────────

    def send_text(self, data: bytes | str) -> None:
        """Send a text frame now; look at ``writable`` first for anything that can wait."""
        transport = self._transport
        if transport is not None:
            size = len(data)
            self.bytes_out += size
            self.frames_out += 1
            transport.send(WSMsgType.TEXT, data)
            self.flow.sent(size)

    def send_binary(self, data: bytes | bytearray | memoryview) -> None:
        """Send a binary frame now; look at ``writable`` first for anything that can wait."""
        transport = self._transport
        if transport is not None:
            size = len(data)
            self.bytes_out += size
            self.frames_out += 1
            transport.send(WSMsgType.BINARY, data)
            self.flow.sent(size)

    def send_binary_parts(self, head: bytes, body: bytes) -> None:
        """Send two parts as one binary frame; a large ``body`` is given to the operating system without a copy.

        So one message that many peers get is held once, however many of them are slow.
        """
        transport = self._transport
        size = len(head) + len(body)
        if transport is None or transport.is_client_side or size < _LARGE_BYTES:  # a client masks what it sends
            self.send_binary(b"".join((head, body)))
        elif self._closing is None and not self.closed:
            self.bytes_out += size
            self.frames_out += 1
            start = _LARGE_FRAME.pack(_FINAL_BINARY, _LENGTH_FOLLOWS, size) + head
            transport.underlying_transport.writelines((start, body))
            self.flow.sent(size)

    @property
    def writable(self) -> bool:
        """Whether data sent now leaves soon."""
        return self.flow.free

    def _on_free(self) -> None:
        if self._pong is not None:
            ping, self._pong = self._pong, None
            self._answer(ping)
        if self.writable:
            self.on_writable()

    @property
    def unsent_bytes(self) -> int:
        """The bytes that the operating system has not accepted yet."""
        transport = self._transport
        if transport is None:
            return 0
        return int(transport.underlying_transport.get_write_buffer_size())

    def pause_reading(self) -> None:
        """Take no more from the peer for now; the operating system's window then holds it back."""
        if self._transport is not None and not self.closed:
            self._reading = False
            self._transport.underlying_transport.pause_reading()

    def resume_reading(self) -> None:
        """Take from the peer again."""
        if self._transport is not None and not self.closed:
            self._reading = True
            self._last_heard = time.monotonic()
            self._transport.underlying_transport.resume_reading()

    def close(self, code: int = 1000, reason: str = "") -> None:
        """Start the closing handshake; the transport goes within a second whatever the peer does."""
        transport = self._transport
        if transport is None or self._closing is not None or self.closed:
            return
        self._close_code, self._close_reason = code, reason
        self.flow.close()
        self._unfinished = None
        try:
            close_code = WSCloseCode(code)
        except ValueError:
            close_code = WSCloseCode.OK
        transport.send_close(close_code, reason.encode("ascii", "replace")[:120])
        self._closing = asyncio.get_running_loop().call_later(1.0, transport.disconnect, False)

    def abort(self, reason: str) -> None:
        """Drop the connection without a word to the peer."""
        self._close_code, self._close_reason = 1006, reason
        if self._transport is not None:
            self._transport.disconnect(False)

    async def wait_closed(self) -> tuple[int, str]:
        """Wait for the end; gives the close code and the reason."""
        await self._closed.wait()
        return self._close_code, self._close_reason

    # ── picows callbacks ───────────────────────────────────────────────────────────────────────────────────────

    def on_ws_connected(self, transport: WSTransport) -> None:
        """Begin after the handshake; called by picows."""
        self._transport = transport
        underlying = transport.underlying_transport
        underlying.set_write_buffer_limits(high=0, low=0)
        self._socket = underlying.get_extra_info("socket")
        self.secure = underlying.get_extra_info("sslcontext") is not None
        if not self.peer:
            self.peer = peer_address(underlying.get_extra_info("peername"))
        if transport.response is not None:
            headers = transport.response.headers  # the client's side
            self.subprotocol = headers.get("Sec-WebSocket-Protocol", "")
            self.server, self.dated = headers.get("Server", ""), "Date" in headers
        self.flow.open(self._socket)
        self.account.hold("unfinished messages", self._unfinished_bytes)
        self.account.hold("what it does not read", lambda: self.unsent_bytes)
        self._last_heard = time.monotonic()
        if self.limits.ping_interval_s is not None:
            self._watch = asyncio.get_running_loop().create_task(self._watch_peer(), name=f"watch {self.peer}")
            self._watch.add_done_callback(self._watched)
        self.on_connected()

    def on_ws_frame(self, transport: WSTransport, frame: WSFrame) -> None:
        """Take a frame; called by picows."""
        kind = frame.msg_type
        self._last_heard = time.monotonic()
        size = frame.payload_size
        self.bytes_in += size
        if frame.rsv1 or frame.rsv2 or frame.rsv3:
            if self._closing is None:
                self._fail(1002, "a frame with reserved bits came, whose extension nobody asked for")
            return
        if kind == WSMsgType.BINARY or kind == WSMsgType.TEXT:
            if self._closing is not None:
                return
            if self._unfinished is not None:
                self._fail(1002, "a new message began before the last one ended")
            elif frame.fin:
                self.frames_in += 1
                if kind == WSMsgType.BINARY:
                    self.on_binary(frame.get_payload_as_memoryview())
                else:
                    self.on_text(frame.get_payload_as_bytes())
                if self.bytes_in >= self.account.look_at_bytes:
                    self.account.received(self.bytes_in)
            else:
                self._unfinished = bytearray(frame.get_payload_as_memoryview())
                self._unfinished_text = kind == WSMsgType.TEXT
        elif kind == WSMsgType.CONTINUATION:
            if self._closing is None:
                self._continue(frame)
        elif kind == WSMsgType.PING:
            self._answer(frame.get_payload_as_bytes())
        elif kind == WSMsgType.CLOSE:
            code = frame.get_close_code()
            if self._closing is None:
                self._close_code = _number(code) or 1005
                self._close_reason = (
                    frame.get_close_message().decode(errors="replace") if frame.payload_size > 2 else ""
                )
            transport.send_close(code if _number(code) else WSCloseCode.OK)
            transport.disconnect()

    def _continue(self, frame: WSFrame) -> None:
        message = self._unfinished
        if message is None:
            self._fail(1002, "a continuation came without a beginning")
            return
        if len(message) + frame.payload_size > self.limits.max_message_bytes:
            self._fail(1009, f"a message may have {self.limits.max_message_bytes} bytes at most")
            return
        message += frame.get_payload_as_memoryview()
        self.account.received(self.bytes_in)
        if self._unfinished is None:
            return
        if frame.fin:
            self.frames_in += 1
            self._unfinished = None
            data = bytes(message)
            if self._unfinished_text:
                self.on_text(data)
            else:
                self.on_binary(data)

    def _answer(self, ping: bytes) -> None:
        if self.writable:
            assert self._transport is not None
            self._transport.send_pong(ping)
        else:
            self._pong = ping  # only the last one needs an answer, and a peer that does not read gets no more

    def on_ws_disconnected(self, transport: WSTransport) -> None:
        """Clean up when the transport is gone; called by picows."""
        self.flow.close()
        handshake = transport.close_handshake
        if handshake is not None and handshake.sent is not None and self._close_code == 1006:
            sent = handshake.sent
            self._close_code = _number(sent.code)
            self._close_reason = sent.reason or self._close_reason
            log.warning("%s: closed: %s", self.peer, self._close_reason)
        if self._closing is not None:
            self._closing.cancel()
        if self._watch is not None and self._watch is not asyncio.current_task():
            self._watch.cancel()
        self.account.close()
        self._unfinished = self._transport = None  # with all that the transport holds: no cycle keeps it
        if not self.closed:
            self.closed = True
            self._closed.set()
            self.on_closed(self._close_code, self._close_reason)

    def pause_writing(self) -> None:
        """Hold back while the transport holds bytes that the operating system did not take; called by the transport."""
        self.flow.full()

    def resume_writing(self) -> None:
        """Resume when the operating system took everything; called by the transport."""
        self.flow.drained()

    def _fail(self, code: int, reason: str) -> None:
        log.warning("%s: closed: %s", self.peer, reason)
        self.close(code, reason)

    # ── the watch ──────────────────────────────────────────────────────────────────────────────────────────────

    def look(self) -> None:
        """See whether the connection still does what it should; called about once a second."""
        if self._closing is not None or self.closed:
            return
        self.on_look()
        self._look_at_unread()
        self.account.look()

    def _look_at_unread(self) -> None:
        """Close a connection that reads nothing of much that waits for it."""
        unsent, now = self.unsent_bytes, time.monotonic()
        taken = self.bytes_out - unsent
        if unsent <= UNREAD_STATUS_BYTES or taken > self._taken_bytes:
            self._taken_bytes, self._taken_s = taken, now
        elif now - self._taken_s > UNREAD_S:
            self._fail(1008, f"nothing of {unsent} bytes was read for {UNREAD_S:g} s")

    def _unfinished_bytes(self) -> int:
        """Return what is here of a message that is not complete: in continuation frames, and in a single one."""
        unfinished = len(self._unfinished) if self._unfinished is not None else 0
        received = self._received_bytes()
        if self.frames_in != self._frames_seen or received < self._heard_before_frame:
            self._frames_seen, self._heard_before_frame = self.frames_in, received
        return unfinished + min(received - self._heard_before_frame, self.limits.max_message_bytes)

    def _ended_by_budget(self, reason: str) -> None:
        self._fail(1008, reason)

    async def _watch_peer(self) -> None:
        looked_at = time.monotonic()
        while self._transport is not None and not self.closed:
            self._transport.send_ping()
            interval = self.ping_interval_s
            assert interval is not None
            pause_s = interval / _LOOKS_PER_PING
            for _ in range(_LOOKS_PER_PING):
                await asyncio.sleep(pause_s)
                self._was_late(time.monotonic() - looked_at - pause_s)
                received = self._received_bytes()
                # Part of a message counts as a sign of life, and who is not listened to cannot give one.
                if received != self._heard_bytes or not self._reading:
                    self._heard_bytes = received
                    self._last_heard = max(self._last_heard, looked_at)
                self.look()
                looked_at = time.monotonic()
                silence = self.silence_s
                if silence is not None and looked_at - self._last_heard > silence:
                    self.abort(f"nothing was heard for {silence:g} s")
                    return

    def _was_late(self, late_s: float) -> None:
        """Leave time out of account in which our own process did not run: the peer was not silent in it."""
        if late_s > 0:
            self._last_heard += late_s
            self._taken_s += late_s

    def _watched(self, watch: asyncio.Task[None]) -> None:
        if not watch.cancelled() and (error := watch.exception()) is not None:
            log.error("%s: it cannot be watched any more: %s", self.peer, describe(error), exc_info=error)
            self.abort("its silence cannot be watched")

    def _received_bytes(self) -> int:
        info = tcp_info(self._socket)
        return info.bytes_received if info is not None else 0


def _ignore(_: object) -> None:
    return None


def _ignore_close(_code: int, _reason: str) -> None:
    return None


def _nothing() -> None:
    return None


def _number(code: Any) -> int:
    return int(getattr(code, "value", code))


def peer_address(name: Any) -> str:
    """Return the address of a socket's far end as people write it: ``10.1.2.3:4711``, ``[::1]:4711``."""
    if isinstance(name, tuple) and len(name) >= 2:
        return f"[{name[0]}]:{name[1]}" if ":" in str(name[0]) else f"{name[0]}:{name[1]}"
    return str(name or "unknown")
