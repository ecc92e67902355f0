"""Publishers and subscriptions for programs."""

from __future__ import annotations

import asyncio
import contextlib
import logging
import time
from collections.abc import AsyncIterator, Sequence
from typing import TYPE_CHECKING, Final

from ropeway import aio
from ropeway.api.callbacks import Callbacks, MessageCallback
from ropeway.api.inbox import Inbox
from ropeway.api.message import MessageType, TypedMessage
from ropeway.api.part import Part
from ropeway.errors import GraphUnavailable, Refused, TypeConflict, WaitTimeout
from ropeway.graph.base import SEQ_NONE, Sample, Undelivered, new_origin
from ropeway.graph.calls import DEFAULT_TIMEOUT_S
from ropeway.graph.peer_answer import Answering
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.hub.hub import View
    from ropeway.hub.topics import ViewPublisher, ViewSubscription

__all__ = ["AsyncPublisher", "AsyncSubscription"]

log = logging.getLogger("ropeway.api")

_LINGER_S: Final = 0.1  # what was published just now still needs its sender, as in `ros2 topic pub --keep-alive`
_ANSWER_S: Final = 5.0  # a gateway answers within the link's round trip


class AsyncPublisher(Part):
    """A topic that a program publishes; ``AsyncGraph.publisher`` makes it."""

    def __init__(self, view: View, inner: ViewPublisher, messages: MessageType) -> None:
        super().__init__(view)
        self.topic, self.type, self.qos = inner.topic, messages.name, inner.qos
        self._inner, self._messages = inner, messages
        self._origin = new_origin()
        self._refused = ""
        self._answered = asyncio.Event()
        self._demand = asyncio.Event()
        self._last = 0.0
        inner.on_demand(lambda _: self._demand.set())
        if isinstance(inner.inner, Answering):
            inner.inner.on_answer(self._take_answer)
        else:
            self._answered.set()

    def _take_answer(self, reason: str) -> None:
        self._refused = reason
        self._answered.set()
        self._demand.set()

    async def wait_taken(self) -> None:
        """Wait until the peer takes the topic, where there is a peer to say so. Raises ``Refused``."""
        with contextlib.suppress(TimeoutError):
            async with aio.timeout(_ANSWER_S):
                await self._answered.wait()
        self._check()

    def _check(self) -> None:
        if self._refused:
            raise Refused(self._view.name, self.topic, self._refused)
        if self.closed:
            raise GraphUnavailable(self._view.name, f"the publisher of {self.topic} is closed")

    def publish(self, message: object) -> None:
        """Publish a message; never wait.

        ``message`` is a mapping, an object with the fields as attributes, CDR bytes, or a ``TypedMessage``. One that
        was received is passed on as it is, and only once, however often it comes by. Raises ``ValueMismatch`` or
        ``DecodeError`` if it does not fit the type, ``TypeConflict`` if it is of another, ``GraphUnavailable`` after
        ``close``, ``Refused`` if the peer does not take the topic.
        """
        self._check()
        self._last = time.monotonic()
        if isinstance(message, TypedMessage) and message.sample is not None:
            if message.type != self.type:
                raise TypeConflict(self.topic, self.type, message.type)
            self._inner.publish(message.sample)
        else:
            raw = self._messages.encode(message)
            self._inner.publish(Sample(raw, self.type, time.time_ns(), self._origin, SEQ_NONE))

    @property
    def subscribers(self) -> int | None:
        """Return how many read the topic now, ``None`` where the network cannot tell."""
        return self._inner.subscribers

    async def wait_for_subscribers(self, count: int = 1, *, timeout_s: float | None = DEFAULT_TIMEOUT_S) -> None:
        """Wait until ``count`` subscriptions read the topic; return at once where the network cannot tell.

        Raises ``WaitTimeout``, ``Refused`` or ``GraphUnavailable``; ``timeout_s=None`` waits for ever.
        """
        try:
            async with aio.timeout(timeout_s):
                while (found := self.subscribers) is not None and found < count:
                    self._check()
                    self._demand.clear()
                    await self._demand.wait()
        except TimeoutError:
            assert timeout_s is not None
            who = "subscriber" if count == 1 else f"{count} subscribers"
            raise WaitTimeout(f"{who} of {self.topic} on {self._view.name}", timeout_s) from None

    async def close(self) -> None:
        """Withdraw the topic, once what was published last is on its way."""
        if self.closed:
            return
        self.closed = True
        self._demand.set()
        try:
            if self._last:
                await asyncio.sleep(max(self._last + _LINGER_S - time.monotonic(), 0.0))
        finally:
            await super().close()


class AsyncSubscription(Part):
    """A topic that a program reads; ``AsyncGraph.subscribe`` makes it.

    Without a callback, messages wait for ``receive`` and ``async for`` in a queue; if it is full, the oldest go.
    """

    def __init__(
        self, view: View, topic: str, messages: MessageType, inbox: Inbox, callback: MessageCallback | None
    ) -> None:
        super().__init__(view)
        self.topic, self.type = topic, messages.name
        self.failures = 0
        self._messages, self._inbox = messages, inbox
        self._inner: ViewSubscription | None = None
        label = f"{topic} of {view.name}"
        self._callbacks = None if callback is None else Callbacks(callback, inbox, label, self._failed)

    def attach(self, inner: ViewSubscription) -> None:
        """Follow the subscription on the graph."""
        self._inner = inner
        network: object = inner.inner
        if isinstance(network, Answering):
            network.on_answer(self._answered)

    def _answered(self, reason: str) -> None:
        error = Refused(self._view.name, self.topic, reason) if reason else None
        if self._callbacks is None:
            self._inbox.fail(error)
        elif error is not None:
            log.error("%s", error)

    def arrived(self, batch: Sequence[Sample]) -> None:
        """Take what came from the graph."""
        take = self._inbox.put if self._callbacks is None else self._callbacks.put
        for sample in batch:
            take(self._messages.message(sample.payload, topic=self.topic, sample=sample))

    def _failed(self) -> None:
        self.failures += 1
        self._view.drops[self.topic, Undelivered.CALLBACK] += 1

    @property
    def qos(self) -> QoS:
        """Return the profile in use: as asked, or what the publishers offer."""
        assert self._inner is not None
        return self._inner.qos

    @property
    def dropped(self) -> int:
        """Return how many messages were dropped because the program did not take them in time."""
        return self._inbox.dropped

    async def receive(self, *, timeout_s: float | None = DEFAULT_TIMEOUT_S) -> TypedMessage:
        """Return the next message.

        Raises ``WaitTimeout`` if none comes in time (``None`` waits for ever), ``Refused`` if the peer does not give
        the topic, ``GraphUnavailable`` after ``close``.
        """
        self._check_queue()
        try:
            async with aio.timeout(timeout_s):
                message = await self._inbox.get()
        except TimeoutError:
            assert timeout_s is not None
            raise WaitTimeout(f"message on {self.topic} of {self._view.name}", timeout_s) from None
        if message is None:
            raise GraphUnavailable(self._view.name, f"the subscription of {self.topic} is closed")
        return message

    async def __aiter__(self) -> AsyncIterator[TypedMessage]:
        self._check_queue()
        while (message := await self._inbox.get()) is not None:
            yield message

    def _check_queue(self) -> None:
        if self._callbacks is not None:
            raise RuntimeError(f"the messages of {self.topic} go to a callback; subscribe without one to wait for them")

    async def close(self) -> None:
        """Stop reading; loops over the messages end."""
        self._inbox.close()
        if self._callbacks is not None:
            await self._callbacks.close()
        await super().close()
