"""Publishes the time of a recording on ``/clock`` while it is played, for nodes with ``use_sim_time``."""

from __future__ import annotations

import asyncio
from typing import Final

from ropeway.graph.base import SEQ_NONE, Graph, Publisher, Sample, new_origin
from ropeway.qos import QoS
from ropeway.recording.bag import Bag

__all__ = ["RecordedClock"]

_TYPE: Final = "rosgraph_msgs/msg/Clock"
_QOS: Final = QoS(reliability="best_effort", depth=1)  # that of ROS's own clocks


class RecordedClock:
    """Tells the time of the recording: every so often, and before each message, so that none is from the future."""

    def __init__(self, publisher: Publisher, bag: Bag, hz: float, rate: float) -> None:
        self._publisher = publisher
        self._codec = bag.registry.codec(_TYPE)
        self._period_s, self._rate, self._origin = 1.0 / hz, rate, new_origin()
        self._told_at = float("-inf")

    @classmethod
    async def on(cls, graph: Graph, bag: Bag, hz: float, rate: float) -> RecordedClock:
        """Begin to publish ``/clock``, ``hz`` times a second while a recording plays ``rate`` times as fast."""
        return cls(await graph.create_publisher("/clock", _TYPE, _QOS), bag, hz, rate)

    async def until(self, time_ns: int, due: float, ends: float) -> None:
        """Tell the time until that of a message that is due at a time of the loop, and that time itself."""
        loop = asyncio.get_running_loop()
        while (next_at := max(self._told_at + self._period_s, loop.time())) < min(due, ends):
            await asyncio.sleep(next_at - loop.time())
            self._tell(time_ns - int((due - loop.time()) * self._rate * 1e9))
        if due < ends and loop.time() >= self._told_at + self._period_s:
            self._tell(time_ns)

    def _tell(self, time_ns: int) -> None:
        self._told_at = asyncio.get_running_loop().time()
        sec, nanosec = divmod(max(time_ns, 0), 1_000_000_000)
        payload = self._codec.encode({"clock": {"sec": sec, "nanosec": nanosec}})
        self._publisher.publish(Sample(payload, _TYPE, time_ns, self._origin, SEQ_NONE))

    async def close(self) -> None:
        """Publish no more."""
        await self._publisher.close()
