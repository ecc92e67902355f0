"""Measures what members, names and heartbeats cost in the overlay, and what decisions of a group cost.

``python -m bench.scale`` prints the figures that ``docs/scale.md`` reckons with.
"""

from __future__ import annotations

import os
import tempfile
import time
import tracemalloc
from collections.abc import Callable
from pathlib import Path
from typing import Final

from ropeway.group.bound import LatencyBound
from ropeway.group.scheduler import Scheduler
from ropeway.networks.overlay.advert import Advertisement, advert_key, make_advert
from ropeway.networks.overlay.announcement import NoteKey
from ropeway.networks.overlay.crypto.identity import Identity
from ropeway.networks.overlay.fleet import Fleet
from ropeway.networks.overlay.names import Metadata, global_name
from ropeway.networks.overlay.node import new_endpoint
from ropeway.networks.overlay.rib import Rib
from ropeway.qos import QoS

NAMES: Final = 1000
HEARTBEATS: Final = 500
REQUESTS: Final = 3000
RATE_HZ: Final = 30.0
TYPE: Final = "std_msgs/msg/String"
YEAR_NS: Final = 365 * 86_400 * 10**9


def took_us(count: int, work: Callable[[], object]) -> float:
    """Return the processor time of one of ``count``, in microseconds."""
    began = time.process_time()
    work()
    return 1e6 * (time.process_time() - began) / count


def advertisement(secret: bytes, gateway: bytes, name: str) -> Advertisement:
    """Return what tells of a publisher."""
    about, now_ns = Metadata(), time.time_ns()
    return Advertisement(
        kind="publisher",
        global_name=global_name(secret, "topic", name, TYPE, about),
        endpoint=new_endpoint(),
        gateway=gateway,
        name=name,
        type=TYPE,
        qos=QoS(),
        encoding="auto",
        metadata=about,
        since_ns=now_ns,
        expires_ns=now_ns + YEAR_NS,
    )


def advertisements(identity: Identity, secret: bytes) -> None:
    """Print what an advertisement costs who makes it and who reads it."""
    gateway, key = os.urandom(16), advert_key(secret)
    adverts = [advertisement(secret, gateway, f"/t{number}") for number in range(NAMES)]
    made_us = took_us(NAMES, lambda: [make_advert(advert, identity, key) for advert in adverts])
    raws = [make_advert(advert, identity, key) for advert in adverts]
    rib = Rib(secret, refused=lambda who, error: None)

    def read() -> None:
        rib.replace(gateway, identity.certificate, rib.read_all(gateway, identity.certificate, raws))

    read_us = took_us(NAMES, read)
    tracemalloc.start()
    kept = rib.read_all(gateway, identity.certificate, raws)
    memory = tracemalloc.get_traced_memory()[0] / len(kept)
    tracemalloc.stop()
    size = sum(map(len, raws)) / NAMES
    print(f"advertisement: made {made_us:.0f} us, read {read_us:.0f} us, {size:.0f} bytes, {memory:.0f} in memory")


def heartbeats(identity: Identity, secret: bytes) -> None:
    """Print what a heartbeat costs who hears it."""
    notes, gateway = NoteKey(secret), os.urandom(16)
    raw = notes.seal(gateway, "heartbeat", {"t": time.time_ns(), "v": 1, "w": {}, "r": 1}, identity.sign)

    def hear() -> None:
        for _ in range(HEARTBEATS):
            notes.open(raw, gateway, "heartbeat", {"t": int}, lambda _: identity.certificate)

    print(f"heartbeat: {took_us(HEARTBEATS, hear):.0f} us, {len(raw)} bytes")


def decisions(members: int) -> None:
    """Print what the scheduler costs for each request."""
    names = [f"m{number}" for number in range(members)]
    scheduler = Scheduler(names, LatencyBound.of({"median": 0.05}))
    for name in names:
        scheduler.came(name, 0.0)

    def ask() -> None:
        for number in range(REQUESTS):
            now_s = number / RATE_HZ
            targets = scheduler.targets(now_s)
            scheduler.asked(targets, number, now_s)
            for name in targets:
                scheduler.answered(name, number, now_s + 0.01)

    cost_us = took_us(REQUESTS, ask)
    print(f"scheduler of {members}: {cost_us:.1f} us per request, {1e-4 * cost_us * RATE_HZ:.3f} % of a core at 30 Hz")


def main() -> None:
    """Print all of them."""
    with tempfile.TemporaryDirectory() as directory:
        identity = Fleet.create("scale", Path(directory) / "scale").issue("robot")
    assert identity.name_secret is not None
    advertisements(identity, identity.name_secret)
    heartbeats(identity, identity.name_secret)
    for members in (4, 100):
        decisions(members)


if __name__ == "__main__":
    main()
