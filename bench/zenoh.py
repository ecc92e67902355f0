"""What it takes to join rmw_zenoh and DDS: delay, losses and processor time, beside DDS joined with DDS.

One process bridges one topic; another publishes on one side and reads on the other. Each pair of networks carries
images of 305 kB at 60 Hz, and messages of 1 kB at 2,000 per second. The pairs take turns, so that what else runs on the
machine disturbs all of them alike.
"""

from __future__ import annotations

from typing import Final

import uvloop
from tests.support.ports import free_port

from bench.bridged import BYTES, Ends, Work, compare, options

PAIRS: Final = (("dds", "dds"), ("zenoh", "dds"), ("dds", "zenoh"), ("zenoh", "zenoh"))
WORKS: Final = (
    Work("305 kB, 60 Hz", "sensor_msgs/msg/Image", 305_000, 60.0),
    Work("1 kB, 2,000 Hz", BYTES, 1_000, 2_000.0),
)


def _ends(kind: str, domain: int) -> Ends:
    if kind == "dds":
        return (f"dds:{domain}?interface=lo",) * 2
    one, other = (f"tcp/127.0.0.1:{free_port()}" for _ in range(2))
    return f"zenoh:{one}?domain={domain}&listen={other}", f"zenoh:{other}?domain={domain}&listen={one}"


if __name__ == "__main__":
    uvloop.run(compare(WORKS, PAIRS, _ends, options(__doc__)))
