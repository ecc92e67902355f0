"""What is fuzzed: a parser, the errors that are its own, and what an input may cost."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

__all__ = ["Target"]


@dataclass(frozen=True, slots=True)
class Target:
    """A parser that takes any bytes.

    ``run`` feeds it; whatever it raises beyond ``errors`` is a fault, and so is an assertion of ``run`` about what came
    out. ``seeds`` gives good inputs to begin with, ``words`` the tokens of its grammar.

    An input of n bytes may hold ``memory_bytes + n * memory_per_byte`` at most while it is read and take ``cpu_s``
    seconds of CPU time. The bounds leave room for instrumented code; what they are to find is growth by the thousand.
    """

    run: Callable[[bytes], object]
    errors: tuple[type[Exception], ...] = ()
    seeds: Callable[[], Iterable[bytes]] = tuple
    words: tuple[bytes, ...] = ()
    longest_bytes: int = 4096
    memory_bytes: int = 8 << 20
    memory_per_byte: int = 64
    cpu_s: float = 0.5
