"""Sends to one viewer: its answers in order, and of every topic the freshest, when the link can take it."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from struct import Struct
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from ropeway.delivery.outbox import SMALL_BYTES, Lost, Outbox, Queue
from ropeway.errors import TypesError
from ropeway.graph.signal import Signal
from ropeway.limits import UNREAD_ANSWERS_BYTES, WAITING_ANSWERS
from ropeway.networks.foxglove.wire import MESSAGE_HEADER_BYTES, time_frame

if TYPE_CHECKING:
    from ropeway.graph.base import Sample
    from ropeway.listener.connection import Connection

__all__ = ["ViewerSender", "ViewerStream"]

_TIME: Final = Struct("<Q").pack
_BYTES_PER_ANSWER: Final = UNREAD_ANSWERS_BYTES // WAITING_ANSWERS  # an answer of more counts as several


class ViewerStream(Protocol):
    """A topic on its way to a viewer; the ``key`` of its queue."""

    prefix: bytes
    """The bytes that each of its frames begins with."""

    def body(self, sample: Sample) -> bytes:
        """Return the message as the viewer reads it. Raises ``TypesError``."""
        ...

    def unreadable(self, error: TypesError) -> None:
        """Count a message that cannot be written for viewers."""
        ...


class _Answer(NamedTuple):
    data: bytes
    text: bool


class ViewerSender:
    """Holds what waits for one viewer. Not more than ``limit_bytes`` of messages wait, answers apart.

    ``count`` and ``on_gone`` are for ``Turns``. ``on_idle`` is called when the last answer has gone.
    ``now_ns`` gives the time of messages that is told where it is not that of their arrival.
    """

    def __init__(self, connection: Connection, *, limit_bytes: int) -> None:
        self.outbox: Outbox[Sample] = Outbox()
        self.limit_bytes = limit_bytes
        self.on_gone: Callable[[], None] | None = None
        self.on_idle: Callable[[], None] | None = None
        self.now_ns: int | None = None
        self.answers_bytes = 0
        self._answers: deque[_Answer] = deque()
        self._taken = Signal()
        self._connection, self._flow = connection, connection.flow
        self._loop = asyncio.get_running_loop()
        self._scheduled = False
        self._late = False  # the viewer does not know the time
        connection.on_writable = self._pump
        connection.account.hold("messages that wait", lambda: self.outbox.bytes)
        connection.account.hold("answers that wait", lambda: self.answers_bytes)

    @property
    def count(self) -> int:
        """The number of answers that wait; large ones count more than once."""
        return max(len(self._answers), self.answers_bytes // _BYTES_PER_ANSWER)

    @property
    def idle(self) -> bool:
        """Whether no answer waits."""
        return not self._answers

    async def room(self) -> None:
        """Wait until the viewer has taken all its answers: for long ones, of which one at a time is held."""
        while self._answers:
            await self._taken.wait()

    def crowded(self, size: int) -> bool:
        """Return whether an answer of this size is one too many, as the viewer has not taken those before it."""
        return bool(self._answers) and self.answers_bytes + size > UNREAD_ANSWERS_BYTES

    def text(self, data: bytes) -> None:
        """Send an operation, after those before it."""
        self._answer(_Answer(data, True))

    def binary(self, data: bytes) -> None:
        """Send a binary answer, after those before it."""
        self._answer(_Answer(data, False))

    def tell_time(self, time_ns: int) -> None:
        """Tell the time of a simulation, which is that of messages from now on; of several only the last waits."""
        self.now_ns = time_ns
        if self._flow.free:
            self._connection.send_binary(time_frame(time_ns))
        else:
            self._late = True

    def _answer(self, answer: _Answer) -> None:
        if self._flow.free and not self._answers:
            self._give(answer)
            return
        self._answers.append(answer)
        self.answers_bytes += len(answer.data)

    def _give(self, answer: _Answer) -> None:
        if answer.text:
            self._connection.send_text(answer.data)
        else:
            self._connection.send_binary(answer.data)

    def put(self, queue: Queue[Sample], sample: Sample) -> None:
        """Let a message wait for its turn; it is sent in this turn of the event loop if the link takes it."""
        outbox, free = self.outbox, self._flow.free
        size = len(sample.payload)
        if free and queue.waiting and outbox.full(queue, size):
            self._pump()
            free = self._flow.free
        if outbox.bytes + size > self.limit_bytes and outbox.bytes > queue.bytes:
            queue.lost[Lost.OVERFLOW] += 1
            return
        outbox.put(queue, sample)
        if free and not self._scheduled:
            self._scheduled = True
            self._loop.call_soon(self._pump_once)

    def _pump_once(self) -> None:
        self._scheduled = False
        self._pump()

    def _pump(self) -> None:
        """Send while the link takes it."""
        flow, answers, outbox = self._flow, self._answers, self.outbox
        while answers and flow.free:
            answer = answers.popleft()
            self.answers_bytes -= len(answer.data)
            self._give(answer)
            if self.on_gone is not None:
                self.on_gone()
            if not answers:
                self._taken.notify()
                if self.on_idle is not None:
                    self.on_idle()
        if self._late and self.now_ns is not None and flow.free:
            self._late = False
            self._connection.send_binary(time_frame(self.now_ns))
        while outbox.messages and flow.free:
            self._send_next()

    def _send_next(self) -> None:
        outbox, now_ns = self.outbox, time.time_ns()
        taken = outbox.take_ready(SMALL_BYTES, MESSAGE_HEADER_BYTES, now_ns)
        if taken is not None:
            self._send(*taken)
            return
        for lane in outbox.lanes():
            taken = outbox.take(lane, now_ns)
            if taken is not None:
                queue, sample = taken
                outbox.served(queue, self._send(queue, sample))
                outbox.done(queue)
            return

    def _send(self, queue: Queue[Sample], sample: Sample) -> int:
        """Send a message; return its size."""
        stream: ViewerStream = queue.key
        try:
            body = stream.body(sample)
        except TypesError as error:
            queue.lost[Lost.ENCODE] += 1
            stream.unreadable(error)
            return 0
        stamp = _TIME(sample.stamp_ns if self.now_ns is None else self.now_ns)
        self._connection.send_binary_parts(stream.prefix + stamp, body)
        return MESSAGE_HEADER_BYTES + len(body)

    def close(self) -> None:
        """Forget what waits: the viewer is gone."""
        self._answers.clear()
        self.answers_bytes = 0
        self._taken.notify()
        self.outbox.clear()
