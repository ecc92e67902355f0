"""Keeps a link up: reconnects soon after a cut, and less and less often while nobody answers."""

from __future__ import annotations

import asyncio
import enum
import logging
import random
import time
from collections.abc import Awaitable, Callable
from dataclasses import replace
from typing import Final

from ropeway.errors import ConnectFailed
from ropeway.graph.peer_answer import Answers
from ropeway.listener.connection import Limits
from ropeway.tasks import Supervised, describe, end

__all__ = ["LinkState", "Reconnect"]

log = logging.getLogger("ropeway.rosbridge")

_FIRST_RETRY_S: Final = 0.1
_PATIENT_AFTER_S: Final = 300.0  # a peer that is away for long is asked less often
_EAGER_RETRY_S: Final = 0.5  # until then it is asked at least so often, to be back soon after a cut
_HASTY_S: Final = 1.5  # a link that is cut says nothing: waiting longer would miss its return
_PATIENT_TURN: Final = 4  # every so many tries take their time, for links that are slow
_LAZY_RETRY_S: Final = 10.0


class LinkState(enum.Enum):
    """The state of a connection."""

    IDLE = "idle"
    CONNECTING = "connecting"
    CONNECTED = "connected"
    WAITING = "waiting to retry"
    CLOSED = "closed"


class Reconnect:
    """Keeps a link connected: dials, waits and dials again.

    ``connect`` makes one connection within the limits that it is given, or raises ``ConnectFailed``; it gives what
    lasts as long as the connection does. ``rtt_s`` is how long the peer took to answer, as far as it is known.
    """

    def __init__(
        self, name: str, limits: Limits, connect: Callable[[Limits], Awaitable[Callable[[], Awaitable[None]]]]
    ) -> None:
        self.name, self.limits = name, limits
        self.state = LinkState.IDLE
        self.last_error = ""
        self.answers = Answers()
        self.rtt_s = 0.0
        self.leaving = False
        self._connect = connect
        self._callbacks: list[Callable[[LinkState], None]] = []
        self._task: Supervised | None = None
        self._first: asyncio.Future[ConnectFailed | None] | None = None

    @property
    def started(self) -> bool:
        """Whether ``start`` was called, and ``stop`` was not."""
        return self._task is not None

    def start(self) -> None:
        """Keep the link up from now on."""
        self._first = asyncio.get_running_loop().create_future()
        self._task = Supervised(self._run, f"link {self.name}", on_failure=self._broke).start()

    async def first(self) -> None:
        """Wait until the first connection stands. Raises ``ConnectFailed`` if the first try fails."""
        assert self._first is not None
        error = await asyncio.shield(self._first)
        if error is not None:
            raise error

    async def left(self) -> None:
        """Wait until all that belongs to the link has ended, after its connection was closed with ``leaving`` set."""
        if self._task is not None:
            await self._task.wait()

    async def stop(self) -> None:
        """Stop reconnecting."""
        await end(self._task)
        self._task = None

    def on_state(self, callback: Callable[[LinkState], None]) -> None:
        """Call with the state of the connection, now and at each change."""
        self._callbacks.append(callback)
        callback(self.state)

    def set_state(self, state: LinkState) -> None:
        """Set the state of the connection."""
        if state is LinkState.CONNECTED:
            self._tried(None)
            self.answers.tell("")
        if state is not self.state:
            self.state = state
            for callback in list(self._callbacks):
                try:
                    callback(state)
                except Exception:  # a callback is somebody else's code
                    log.exception("%s: a callback for the state of the link failed", self.name)

    def _tried(self, error: ConnectFailed | None) -> None:
        if self._first is not None and not self._first.done():
            self._first.set_result(error)

    def _patience(self, attempt: int) -> Limits:
        if attempt % _PATIENT_TURN == 0:
            return self.limits
        return replace(self.limits, open_timeout_s=min(self.limits.open_timeout_s, max(_HASTY_S, 8 * self.rtt_s)))

    async def _run(self) -> None:
        delay, down_since, attempt = _FIRST_RETRY_S, time.monotonic(), 0
        while True:
            self.set_state(LinkState.CONNECTING)
            try:
                converse = await self._connect(self._patience(attempt))
            except ConnectFailed as error:
                self._failed(error)
                delay = delay if error.retryable else _LAZY_RETRY_S
            else:
                delay, attempt = _FIRST_RETRY_S, 0
                self.last_error = ""
                await converse()
                down_since = time.monotonic()
            attempt += 1
            if self.leaving:
                return
            self.set_state(LinkState.WAITING)
            await asyncio.sleep(delay * random.uniform(0.7, 1.3))  # noqa: S311  # jitter, not a secret
            patient = time.monotonic() - down_since > _PATIENT_AFTER_S
            delay = min(2 * delay, _LAZY_RETRY_S if patient else _EAGER_RETRY_S)

    def _broke(self, error: BaseException) -> None:
        """Record an unforeseen failure; the link is made anew."""
        self.last_error = describe(error)
        self._tried(ConnectFailed(self.name, self.last_error))
        self.set_state(LinkState.WAITING)

    def _failed(self, error: ConnectFailed) -> None:
        if self.last_error != str(error):
            self.last_error = str(error)
            log.warning("%s (trying again %s)", error, "until it answers" if error.retryable else "every 10 s")
        self._tried(error)
        if not error.retryable:
            self.answers.tell(error.reason)
