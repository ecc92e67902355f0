"""Resolves names as clients write them: relative and private ones, and the substitutions of ROS 2, belong to
our node.
"""

from __future__ import annotations

import re
from typing import Final

from ropeway.errors import InvalidName
from ropeway.graph.base import resolve_name
from ropeway.limits import NAME_CHARACTERS

__all__ = ["Names"]

_SUBSTITUTION: Final = re.compile(r"\{([^{}]*)\}")


class Names:
    """Resolves names for the clients of the node ``node`` (``/rosbridge_websocket``), as rosbridge does for its own.

    ``ros1`` takes ``~x`` for ``~/x``, as ROS 1 does.
    """

    def __init__(self, node: str, *, ros1: bool = False) -> None:
        self.node = node
        self._ros1 = ros1
        self._parts = {"node": node.rpartition("/")[2], "ns": node.rpartition("/")[0] or "/"}
        self._parts["namespace"] = self._parts["ns"]

    def resolve(self, name: str) -> str:
        """Return the absolute name. Raises ``InvalidName`` with the rule that the name breaks."""
        if isinstance(name, str) and len(name) <= NAME_CHARACTERS and (name.startswith("~") or "{" in name):
            return resolve_name(self._expanded(name))
        return resolve_name(name)

    def _expanded(self, name: str) -> str:
        if name.startswith("~"):
            rest = name[1:]
            if rest and not rest.startswith("/"):
                if not self._ros1:
                    raise InvalidName(name, "a slash has to follow the ~ of a private name, as in ~/x")
                rest = f"/{rest}"
            name = self.node + rest

        def part(found: re.Match[str]) -> str:
            if found[1] not in self._parts:
                raise InvalidName(name, f"{found[0]} is not known; use {{node}}, {{ns}} or {{namespace}}")
            return self._parts[found[1]]

        expanded = _SUBSTITUTION.sub(part, name)
        return expanded.removeprefix("/") if expanded.startswith("//") else expanded
