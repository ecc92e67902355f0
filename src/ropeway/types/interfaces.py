"""Texts of interfaces: what stands in them, and whose part a definition is."""

from __future__ import annotations

from collections.abc import Collection, Iterable
from typing import Final

from ropeway.types.definition import Definition, short_name
from ropeway.types.parser import PARTS, is_idl, parse_interface, parse_sections

__all__ = ["concatenated", "layout_text", "owner_of", "parse", "parse_full", "sources_of"]

_RULE: Final = "=" * 80


def parse(full: str, text: str, *, siblings: Collection[str]) -> list[Definition]:
    """Return what a .msg, .srv, .action or .idl text defines; ``siblings`` are known beside it."""
    if not is_idl(text):
        return parse_interface(full, text, siblings=siblings)
    from ropeway.types.idl import parse_idl  # seldom needed

    return parse_idl(full, text)


def sources_of(full: str, text: str, parsed: Iterable[Definition]) -> dict[str, str]:
    """Return the text of the service or action ``full``, as a .srv or .action file; nothing for a message."""
    parts = {definition.name: definition for definition in parsed}
    if full in parts:
        return {}
    if is_idl(text):
        text = "---\n".join(parts[full + end].text() for end in PARTS[full.split("/")[1]])
    return {full: text}


def concatenated(text: str, dependencies: Iterable[tuple[str, str]]) -> str:
    """Return a definition followed by its dependencies, which are given by name and text.

    Each comes after a line of 80 ``=`` and a line ``MSG: pkg/Name``.
    """
    pieces = [text]
    for name, below in dependencies:
        named = short_name(name) if name.split("/")[1] == "msg" else name
        pieces.append(f"{_RULE}\nMSG: {named}\n{below}")
    return "".join(piece if piece.endswith("\n") or not piece else piece + "\n" for piece in pieces)


def layout_text(definition: Definition) -> str:
    """Return the fields of a definition on one line, for errors."""
    return "{" + "; ".join(f"{f.type.spelled()} {f.name}" for f in definition.wire_fields) + "}"


def parse_full(full: str, text: str) -> tuple[list[Definition], dict[str, str]]:
    """Return the definitions in a concatenated text, and the texts of its services and actions."""
    sections = list(parse_sections(full, text))
    siblings = {section for section, _ in sections}
    definitions: list[Definition] = []
    sources: dict[str, str] = {}
    for section, body in sections:
        parsed = parse(section, body, siblings=siblings)
        definitions.extend(parsed)
        sources.update(sources_of(section, body, parsed))
    return definitions, sources


def owner_of(full: str) -> str:
    """Return the service or action that the part ``full`` belongs to, or ``full`` itself."""
    package, kind, name = full.split("/")
    if kind == "srv":
        name = name.removesuffix("_Request").removesuffix("_Response").removesuffix("_Event")
    elif kind == "action":
        for end in ("_Request", "_Response", "_Event"):
            name = name.removesuffix(end)
        for end in ("_SendGoal", "_GetResult", "_Goal", "_Result", "_Feedback", "_FeedbackMessage"):
            if name.endswith(end):
                name = name.removesuffix(end)
                break
    return f"{package}/{kind}/{name}"
