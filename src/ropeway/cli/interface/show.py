"""``ropeway interface show``: a definition, with what its fields consist of."""

from __future__ import annotations

import re
from collections.abc import Iterator
from typing import Annotated, Final

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.interface.common import AskedGraphOption, InterfaceArgument, find_interface
from ropeway.cli.session import JsonOption, TypesOption
from ropeway.types import TypeRegistry

__all__ = ["app", "definition_lines"]

app = typer.Typer(add_completion=False)

_PARTS: Final = {"msg": ("",), "srv": ("_Request", "_Response"), "action": ("_Goal", "_Result", "_Feedback")}
_FIELD: Final = re.compile(r"\s*[\w/]+(?:<=\d+)?(?:\[[<=\d]*\])?\s+(?P<name>\w+)\s*(?!=)")


def definition_lines(
    registry: TypeRegistry, full: str, *, comments: bool = True, all_comments: bool = False
) -> Iterator[str]:
    """Give the lines of a definition, below each field those of its type, deeper by a tab.

    Its own comments are kept unless told otherwise, those of the types of its fields only with ``all_comments``.
    """
    parts = iter(_PARTS[full.split("/")[1]])
    part = next(parts)
    for line in registry.text(full).splitlines():
        if line.strip() == "---":
            part = next(parts, "")
            yield "---"
            continue
        if not comments and not (line := _bare(line)):
            continue
        yield line
        below = _type_of(registry, full + part, line)
        if below:
            for inner in definition_lines(registry, below, comments=all_comments, all_comments=all_comments):
                yield f"\t{inner}"


def _bare(line: str) -> str:
    """Return the line without its comment; a ``#`` in a text is none."""
    quote = ""
    for place, character in enumerate(line):
        if character == quote:
            quote = ""
        elif not quote and character in "\"'":
            quote = character
        elif not quote and character == "#":
            return line[:place].rstrip()
    return line.rstrip()


def _type_of(registry: TypeRegistry, part: str, line: str) -> str:
    """Return the message type of the field that a line defines, ``""`` for other lines and types."""
    found = _FIELD.match(line.partition("#")[0])
    if found is None:
        return ""
    for field in registry.definition(part).fields:
        if field.name == found["name"] and field.type.is_message and registry.has(field.type.base):
            return field.type.base
    return ""


@app.command("show")
def show(
    type: InterfaceArgument,
    all_comments: Annotated[bool, typer.Option("--all-comments", help="Comments of nested types, too.")] = False,
    no_comments: Annotated[bool, typer.Option("--no-comments", help="No comments.")] = False,
    graph: AskedGraphOption = "",
    types: TypesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the definition of TYPE."""
    registry, full = find_interface(type, graph, types)
    if as_json:
        print_json(
            {
                "name": full,
                "hash": registry.hash(full),
                "text": registry.text(full),
                "dependencies": sorted(_dependencies(registry, full)),
            }
        )
        return
    for line in definition_lines(registry, full, comments=not no_comments, all_comments=all_comments):
        answer(line)


def _dependencies(registry: TypeRegistry, full: str) -> set[str]:
    """Return the types that the parts of an interface consist of."""
    return {below for part in _PARTS[full.split("/")[1]] for below in registry.dependencies(full + part)}
