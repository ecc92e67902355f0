"""How much a gateway grows when it is sent a megabyte of something, and what of it stays.

``python -m tests.soak.measure [NAME ...]`` prints a row per kind; each is measured in a gateway of its own, a fresh
process.
"""

from __future__ import annotations

import argparse
import asyncio
from contextlib import AsyncExitStack
from typing import NamedTuple

from bench.report import table

from ropeway import aio
from tests.soak.kinds import KINDS, Kind
from tests.soak.process import Served, serving

__all__ = ["Growth", "grown_by"]

_OBJECTS = 1100  # of one class that may stay: what is remembered of calls and names is bounded by 1,024
_IDLE_LOOKS = 3
_BUSY_S = 0.05


class Growth(NamedTuple):
    """What a gateway had beyond what it had before: at most, and once everybody had left again."""

    peak_bytes: int
    left_bytes: int
    left: dict[str, int]


async def grown_by(kind: Kind) -> Growth:
    """Measure one kind."""
    async with AsyncExitStack() as place:
        config = await kind.prepare(place)
        gateway = await place.enter_async_context(serving(config))
        async with AsyncExitStack() as first:  # what is made for the first visitor stays
            await kind.visit(gateway.ports, first, True)
        before = await gateway.settled()
        gateway.forget_peak()
        async with AsyncExitStack() as stack:
            await kind.visit(gateway.ports, stack, False)
            await _idle(gateway)
        after = await gateway.settled(before, at_most=_OBJECTS)
        peak = gateway.peak_bytes()
    return Growth(peak - before.rss_bytes, after.rss_bytes - before.rss_bytes, after.grown(before, at_most=_OBJECTS))


async def _idle(gateway: Served, timeout_s: float = 60) -> None:
    """Wait until the gateway has nothing more to do."""
    idle = 0
    async with aio.timeout(timeout_s):
        while idle < _IDLE_LOOKS:
            before = gateway.busy_s()
            await asyncio.sleep(0.2)
            idle = idle + 1 if gateway.busy_s() - before < _BUSY_S else 0


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("names", nargs="*", help="kinds, or the beginnings of their names; all without")
    parser.add_argument("--json", action="store_true")
    args = parser.parse_args()
    rows = []
    for kind in KINDS:
        if args.names and not kind.name.startswith(tuple(args.names)):
            continue
        growth = asyncio.run(grown_by(kind))
        mib = [round(size / (1 << 20), 1) for size in growth[:2]]
        rows.append([kind.name, *mib, str(growth.left or "")])
        print(*rows[-1], flush=True)
    table("growth for a megabyte, MiB", ["kind", "peak", "stays", "objects"], rows, as_json=args.json)


if __name__ == "__main__":
    main()
