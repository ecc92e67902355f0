"""Looks for files that import each other in a circle: ``python -m tests.circles``, as ``make lint`` does.

Imports for type checkers count, and those in functions: who wants to understand a file needs the others. What a file
needs of one that imports it, it says in a protocol.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Mapping

import grimp

__all__ = ["circles", "imports_of"]


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


def imports_of(package: str) -> dict[str, set[str]]:
    """Return which file of a package imports which; what the package itself exports is imported at its first use."""
    graph = grimp.build_graph(package, cache_dir=None)

    def short(name: str) -> str:
        return name.removeprefix(f"{package}.")

    modules = graph.modules - {package}
    return {short(name): {short(n) for n in graph.find_modules_directly_imported_by(name)} for name in modules}


def main() -> int:
    """Print what is wrong, and return whether something is."""
    told = [
        f"these files import each other in a circle: {', '.join(circle)}" for circle in circles(imports_of("ropeway"))
    ]
    print("\n".join(told) or "no circles of imports", file=sys.stderr if told else sys.stdout)
    return bool(told)


if __name__ == "__main__":
    sys.exit(main())
