"""A megabyte of each kind of packet that a node may send."""

from __future__ import annotations

from typing import Final

from ropeway.iort import pack
from tests.soak.megabytes import Make

__all__ = ["PACKETS"]


def _asked(op: str, system: str, topic: str, data: bytes = b"", **head: object) -> bytes:
    return pack("01", system, topic, op, head, data)


PACKETS: Final[dict[str, Make]] = {
    "plain": lambda n: f"%01/S/t{n}/p/{'x' * 30}%".encode(),
    "values": lambda n: _asked("+pub", "S", f"t{n}", b"x" * 1000, n=n),
    "systems": lambda n: _asked("+pub", f"S{n}", "t", b"x", n=n),
    "brought": lambda n: f"%01/S/t{n}/+pub/m=1,v={n + 1}/x%".encode(),
    "large": lambda n: _asked("+pub", "S", f"t{n}", b"x" * 500_000, n=n),
    "escaped": lambda n: _asked("+pub", "S", "t", b"~" * 500_000, n=n),
    "heads": lambda n: b"%01/S/t/+pub/" + b",".join(b"%x=" % i for i in range(180_000)) + b"/x%",
    "long-heads": lambda n: b"%01/S/t/+pub/o=" + b"x" * 900_000 + b"/x%",
    "long-names": lambda n: b"%01/" + b"S" * 900_000 + b"/t/p/x%",
    "subscriptions": lambda n: _asked("+sub", "S", f"t{n}", n=n),
    "patterns": lambda n: _asked("+sub", f"S{n}*", f"t{n}*", n=n),
    "advertisements": lambda n: _asked("+adv", "S", f"t{n}", n=n, k="std_msgs/String", q="x" * 50),
    "reads": lambda n: f"%01/S/t{n}/s%".encode(),
    "gets": lambda n: _asked("+get", "S", "t", n=n) if n else _asked("+pub", "S", "t", b"x" * 5000, n=n),
    "lists": lambda n: _asked("+list", "*", "*", n=n) if n > 300 else _asked("+pub", "S", f"t{n}", b"x", n=n),
    "deletions": lambda n: _asked("+del", "S", f"t{n}", n=n),
    "hellos": lambda n: _asked("+hello", f"R{n}", "-", n=n, v=1, token="x" * 50),
    "watches": lambda n: _asked("+watch", "-", "-", n=n) if n % 2 else _asked("+adv", "S", f"t{n}", n=n),
    "percents": lambda n: b"%" * 10_000,
    "slashes": lambda n: b"%" + b"/" * 10_000,
    "bytes": lambda n: b"%a" * 5_000,
    "no-end": lambda n: b"%01/S/t/p/" + b"x" * 900_000,
    "unknown": lambda n: _asked("+what", "S", "t", n=n),
}
