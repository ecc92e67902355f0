"""What it takes to join an MQTT broker and DDS: delay, losses and processor time, beside DDS joined with DDS.

One process bridges one topic; another publishes on one side and reads on the other. Each pair of networks carries
messages of 305 kB at 30 Hz, and of 1 kB at 2,000 per second, as bytes: reliably (QoS 1), and the small ones also with
best effort (QoS 0). The pairs take turns, so that what else runs on the machine disturbs all of them alike. Needs
Mosquitto (apt install mosquitto), which sends small packets at once here (set_tcp_nodelay).
"""

from __future__ import annotations

import sys
from typing import Final

import uvloop
from tests.networks.mqtt.broker import HAS_BROKER, WHY_NOT, Broker

from bench.bridged import BYTES, Ends, Work, compare, options

PAIRS: Final = (("dds", "dds"), ("mqtt", "dds"), ("dds", "mqtt"))
WORKS: Final = (
    Work("305 kB, 30 Hz", BYTES, 305_000, 30.0),
    Work("1 kB, 2,000 Hz", BYTES, 1_000, 2_000.0),
    Work("1 kB, 2,000 Hz, best effort", BYTES, 1_000, 2_000.0, "best_effort"),
)


if __name__ == "__main__":
    if not HAS_BROKER:
        sys.exit(WHY_NOT)
    with Broker("set_tcp_nodelay true") as broker:

        def ends(kind: str, domain: int) -> Ends:
            """Join the broker without listing what it has, which only this bench uses."""
            url = f"dds:{domain}?interface=lo" if kind == "dds" else f"{broker.url}?discover="
            return url, url

        uvloop.run(compare(WORKS, PAIRS, ends, options(__doc__)))
