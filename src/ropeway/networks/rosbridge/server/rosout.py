"""``/rosout``: the gateway's own warnings and errors on the graph, where every ROS tool looks for them.

Lichtblick takes a server for one of ROS 2 only if something of type ``rcl_interfaces/msg/Log`` is listed.
"""

from __future__ import annotations

import asyncio
import logging
import threading
import time
from collections import deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Final

from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.graph.base import Graph, Publisher
    from ropeway.types import TypeRegistry

__all__ = ["LOG_QOS", "LOG_TYPE", "Rosout"]

LOG_TYPE: Final = "rcl_interfaces/msg/Log"
LOG_QOS: Final = QoS(durability="transient_local", depth=1000, lifespan_s=10.0)
"""The profile that every node of ROS 2 has for the topic."""

_WAITING: Final = 256  # of other threads, until the loop has time
_LONGEST: Final = 4096  # characters


class Rosout(logging.Handler):
    """A handler of the logger ``source`` from ``open`` to ``close``.

    At most ``rate_hz`` messages per second are published, after a first ``burst``; how many were left out is told
    with the next one, and ``dropped`` counts them. What publishing itself logs is not published.
    """

    def __init__(
        self,
        graph: Graph,
        registry: TypeRegistry,
        *,
        source: str = "ropeway",
        level: int = logging.WARNING,
        rate_hz: float = 10.0,
        burst: int = 50,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        super().__init__(level)
        self.dropped = 0
        self._graph, self._source = graph, logging.getLogger(source)
        self._codec = registry.codec(LOG_TYPE)
        self._rate_hz, self._burst, self._clock = rate_hz, burst, clock
        self._tokens, self._filled_at = float(burst), clock()
        self._left_out = 0
        self._waiting: deque[logging.LogRecord] = deque()
        self._scheduled = False
        self._publishing: int | None = None  # the thread that publishes now
        self._publisher: Publisher | None = None
        self._origin = new_origin()
        self._loop: asyncio.AbstractEventLoop | None = None

    async def open(self) -> None:
        """Publish the topic and listen to the logger. Raises what ``Graph.create_publisher`` raises."""
        self._loop = asyncio.get_running_loop()
        self._publisher = await self._graph.create_publisher("/rosout", LOG_TYPE, LOG_QOS)
        self._source.addHandler(self)

    def emit(self, record: logging.LogRecord) -> None:
        """Take a record, in any thread; it is published by the loop in a moment."""
        loop = self._loop
        if loop is None or self._publishing == threading.get_ident():
            self.dropped += 1
            return
        if len(self._waiting) >= _WAITING:
            self.dropped += 1
            self._left_out += 1
            return
        self._waiting.append(record)
        if not self._scheduled:
            self._scheduled = True
            try:
                loop.call_soon_threadsafe(self._publish_all)
            except RuntimeError:  # the loop has been closed meanwhile
                self._loop = None

    def _publish_all(self) -> None:
        self._scheduled = False
        self._publishing = threading.get_ident()
        try:
            while self._waiting:
                self._publish(self._waiting.popleft())
        finally:
            self._publishing = None

    def _publish(self, record: logging.LogRecord) -> None:
        now = self._clock()
        self._tokens = min(self._burst, self._tokens + (now - self._filled_at) * self._rate_hz)
        self._filled_at = now
        if self._tokens < 1 or self._publisher is None:
            self.dropped += 1
            self._left_out += 1
            return
        self._tokens -= 1
        try:
            text = self._text(record)
        except Exception:  # the arguments of a record are somebody else's, and any of them may fail as a text
            self.dropped += 1
            self.handleError(record)
            return
        sec, nanosec = divmod(int(record.created * 1e9), 1_000_000_000)
        message: dict[str, Any] = {
            "stamp": {"sec": sec, "nanosec": nanosec},
            "level": max(10, min(50, record.levelno // 10 * 10)),  # the numbers of Python are those of ROS
            "name": record.name,
            "msg": text,
            "file": record.filename,
            "function": record.funcName or "",
            "line": record.lineno,
        }
        sample = Sample(self._codec.encode(message), LOG_TYPE, time.time_ns(), self._origin, SEQ_NONE)
        self._publisher.publish(sample)

    def _text(self, record: logging.LogRecord) -> str:
        text = record.getMessage()
        if record.exc_info and record.exc_info[1] is not None:
            text += f": {record.exc_info[1]!r}"
        if self._left_out:
            text += f" (before this, {self._left_out} messages were left out)"
            self._left_out = 0
        return text[:_LONGEST].replace("\0", " ").encode(errors="replace").decode()

    async def finish(self) -> None:
        """Leave the logger and withdraw the topic. What waits is published before."""
        self._source.removeHandler(self)
        if self._loop is not None:
            self._publish_all()
        self._loop = None
        publisher, self._publisher = self._publisher, None
        if publisher is not None:
            await publisher.close()
        self.close()
