"""Finds out the type of a name that somebody else has on a graph."""

from __future__ import annotations

import contextlib
from collections.abc import AsyncGenerator
from typing import TYPE_CHECKING, Any, Final, cast

from ropeway import aio
from ropeway.errors import GraphUnavailable, TypeConflict, WaitTimeout
from ropeway.graph.base import GraphEvent
from ropeway.types.definition import canonical_name

if TYPE_CHECKING:
    from ropeway.hub.hub import View

__all__ = ["type_of"]

_MIDDLE: Final = {"topic": "msg", "service": "srv", "action": "action"}  # of the name of a type
_HOLDERS: Final = {"topic": "publisher", "service": "server", "action": "server"}


async def type_of(view: View, kind: str, name: str, given: str, timeout_s: float | None) -> str:
    """Return the full name of the type that was ``given`` for a ``topic``, ``service`` or ``action`` called ``name``.

    Where none was given, return the type that it has, as soon as somebody has it.

    Raises ``WaitTimeout`` if nobody does in time, ``TypeConflict`` if it has several types, ``GraphUnavailable`` if the
    graph is closed meanwhile.
    """
    type = canonical_name(given, _MIDDLE[kind]) if given else await _discovered(view, kind, name, timeout_s)
    await view.learn(type)
    return type


async def _discovered(view: View, kind: str, name: str, timeout_s: float | None) -> str:
    events = cast("AsyncGenerator[GraphEvent, Any]", view.changes())
    async with contextlib.aclosing(events):
        try:
            async with aio.timeout(timeout_s):
                while not (types := tuple(filter(None, view.hub.types_of(kind, name)))):
                    if await anext(events, None) is None:
                        raise GraphUnavailable(view.name, f"it was closed while {name} was waited for")
        except TimeoutError:
            assert timeout_s is not None
            hint = "name its type to go on without it"
            raise WaitTimeout(f"{_HOLDERS[kind]} of {name} on {view.name}", timeout_s, hint) from None
    if len(types) > 1:
        raise TypeConflict(name, types[0], ", ".join(types[1:]))
    return types[0]
