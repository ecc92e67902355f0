"""Looks for files that import each other in a circle: ``python -m tests.circles``, as ``make lint`` does.

Imports for type checkers count, and those in functions: who wants to understand a file needs the others. What still
stands is in ``STANDING``; the list may only become shorter.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping
from typing import Final

import grimp

__all__ = ["STANDING", "circles", "complaints", "imports_of"]

STANDING: Final[Mapping[str, str]] = {
    "networks.rosbridge.client.calls": (
        "networks.rosbridge.client.actions networks.rosbridge.client.graph networks.rosbridge.client.servers "
        "networks.rosbridge.client.services"
    ),
    "networks.rosbridge.client.parts": "networks.rosbridge.client.graph",
    "networks.rosbridge.client.refusals": "networks.rosbridge.client.calls",
    "networks.rosbridge.client.ros1_spelling": "networks.rosbridge.client.graph",
}
"""Which files still import what imports them, each name without ``ropeway.``."""


def circles(imports: Mapping[str, Iterable[str]]) -> list[list[str]]:
    """Return the groups of files of which each reaches every other one by its imports."""
    reached = {name: _reached(imports, name) for name in imports}
    groups = {
        tuple(sorted(other for other in reached[name] if name in reached.get(other, ())))
        for name in imports
        if name in reached[name]
    }
    return sorted(map(list, groups))


def _reached(imports: Mapping[str, Iterable[str]], start: str) -> set[str]:
    found: set[str] = set()
    waiting = list(imports[start])
    while waiting:
        name = waiting.pop()
        if name not in found:
            found.add(name)
            waiting += imports.get(name, ())
    return found


def complaints(imports: Mapping[str, set[str]], standing: Mapping[str, str]) -> list[str]:
    """Return what is wrong: circles beyond those that stand, and names on the list that are not needed any more."""
    known = {name: set(targets.split()) for name, targets in standing.items()}
    left = {name: targets - known.get(name, set()) for name, targets in imports.items()}
    told = [f"these files import each other in a circle: {', '.join(circle)}" for circle in circles(left)]
    standing_circles = [set(circle) for circle in circles(imports)]
    for name, targets in known.items():
        for target in sorted(targets):
            if target not in imports.get(name, ()) or not any({name, target} <= each for each in standing_circles):
                told.append(f"{name} and {target} are in no circle any more: shorten STANDING in tests/circles.py")
    return told


def imports_of(package: str) -> dict[str, set[str]]:
    """Return which file of a package imports which; what the package itself exports is imported at its first use."""
    graph = grimp.build_graph(package, cache_dir=None)

    def short(name: str) -> str:
        return name.removeprefix(f"{package}.")

    modules = graph.modules - {package}
    return {short(name): {short(n) for n in graph.find_modules_directly_imported_by(name)} for name in modules}


def main() -> int:
    """Print what is wrong, and return whether something is."""
    told = complaints(imports_of("ropeway"), STANDING)
    print("\n".join(told) or "no new circles of imports", file=sys.stderr if told else sys.stdout)
    return bool(told)


if __name__ == "__main__":
    sys.exit(main())
