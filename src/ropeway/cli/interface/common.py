"""Provides what the verbs on interfaces share: the known types, and the options that choose among kinds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import complain, fail
from ropeway.cli.loop import run
from ropeway.cli.session import known_types, open_session
from ropeway.errors import InvalidTypeName
from ropeway.types import TypeRegistry

__all__ = [
    "KINDS",
    "ActionsOption",
    "AskedGraphOption",
    "InterfaceArgument",
    "MessagesOption",
    "ServicesOption",
    "chosen_kinds",
    "find_interface",
]

KINDS = {"msg": "Messages", "srv": "Services", "action": "Actions"}
_LEARN_S = 5.0

InterfaceArgument = Annotated[
    str, typer.Argument(help="The interface, such as std_msgs/msg/String.", show_default=False)
]
AskedGraphOption = Annotated[
    str,
    typer.Option(
        "--graph",
        "-g",
        envvar="ROPEWAY_GRAPH",
        help="The network whose nodes are asked where the definition is not known here.",
        show_default=False,
    ),
]
MessagesOption = Annotated[bool, typer.Option("--only-msgs", "-m", help="Only messages.")]
ServicesOption = Annotated[bool, typer.Option("--only-srvs", "-s", help="Only services.")]
ActionsOption = Annotated[bool, typer.Option("--only-actions", "-a", help="Only actions.")]


def chosen_kinds(*, messages: bool, services: bool, actions: bool) -> list[str]:
    """Return the kinds that the options choose; all where they choose none."""
    chosen = [kind for kind, wanted in zip(KINDS, (messages, services, actions), strict=True) if wanted]
    return chosen or list(KINDS)


def find_interface(name: str, graph: str, types: list[Path] | None) -> tuple[TypeRegistry, str]:
    """Return the types and the full name of an interface; end with a sentence where nobody knows it."""
    registry = known_types(types)
    try:
        full = _full(registry, name)
    except InvalidTypeName as error:
        fail(str(error), 2)
    if registry.has(full):
        return registry, full
    if graph:
        registry = run(_learned(graph, types, full))
        if registry.has(full):
            return registry, full
        fail(f"nobody on {graph} told the definition of {full} within {_LEARN_S:g} s")
    registry.definition(full)  # says what there is instead
    raise AssertionError(full)


def _full(registry: TypeRegistry, name: str) -> str:
    """Return the full name: of ``pkg/Name`` the message, else the service or the action of that name."""
    kinds = [kind for kind in KINDS if registry.has(name, kind)] if name.count("/") == 1 else []
    if len(kinds) > 1:
        complain(f"{name} names {' and '.join(kinds)}; {kinds[0]} is shown")
    return registry.canonical(name, kinds[0] if kinds else "msg")


async def _learned(graph: str, types: list[Path] | None, full: str) -> TypeRegistry:
    async with open_session(graph, types) as session:
        await session.know(full, _LEARN_S)
        return session.registry
