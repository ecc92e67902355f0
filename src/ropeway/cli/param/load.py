"""``ropeway param load``: set the parameters of a node that a file of parameters has for it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import typer
import yaml

from ropeway.cli.console import answer, complain, fail, print_json
from ropeway.cli.param.common import NodeArgument, TimeoutOption, ask, plain
from ropeway.cli.param.source import AtMaster, parameters_of, place_name
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph
from ropeway.errors import ValueMismatch
from ropeway.graph.parameters import type_of

__all__ = ["app", "parameters_for"]

app = typer.Typer(add_completion=False)

_PARAMETERS: Final = "ros__parameters"


def parameters_for(document: object, node: str, *, wildcards: bool = True) -> dict[str, Any]:
    """Return what a file of parameters has for a node, names of namespaces joined by dots; later entries win.

    Nodes are named as ROS 2 reads them: ``/ns/node``, nested as ``ns: {node: ...}``, and by ``*`` for any one part of a
    name and ``**`` for any number of parts, unless ``wildcards`` is false. Raises ``ValueError`` for a file that is
    none.
    """
    if not isinstance(document, Mapping):
        raise ValueError("not a file of parameters: expected NODE: {ros__parameters: {...}}")
    wanted = _parts(node)
    found: dict[str, Any] = {}
    for pattern, values in _sections(document, ()):
        if (wildcards or not any("*" in part for part in pattern)) and _matches(pattern, wanted):
            found.update(_flat(values, ""))
    return found


def _parts(name: str) -> tuple[str, ...]:
    return tuple(part for part in name.split("/") if part)


def _sections(level: Mapping[Any, Any], above: tuple[str, ...]) -> Iterator[tuple[tuple[str, ...], Mapping[Any, Any]]]:
    for key, value in level.items():
        if key == _PARAMETERS:
            if not isinstance(value, Mapping):
                raise ValueError(f"{'/'.join(('', *above))}: expected {_PARAMETERS}: {{name: value}}")
            yield above, value
        elif isinstance(value, Mapping):
            yield from _sections(value, (*above, *_parts(str(key))))
        else:
            raise ValueError(f"{'/'.join(('', *above, str(key)))}: expected {_PARAMETERS} below the name of a node")


def _matches(pattern: tuple[str, ...], name: tuple[str, ...]) -> bool:
    if not pattern:
        return not name
    if pattern[0] == "**":
        return any(_matches(pattern[1:], name[start:]) for start in range(len(name) + 1))
    return bool(name) and pattern[0] in ("*", name[0]) and _matches(pattern[1:], name[1:])


def _flat(values: Mapping[Any, Any], above: str) -> Iterator[tuple[str, Any]]:
    for key, value in values.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{above}{key}.")
        else:
            yield f"{above}{key}", value


def _read(file: Path) -> object:
    """Return what the file holds, or end with a sentence."""
    try:
        return yaml.safe_load(file.read_bytes())
    except OSError as error:
        fail(f"{file}: {error.strerror}", 2)
    except yaml.YAMLError as error:
        fail(f"{file} is not YAML: {error}", 2)


@app.command("load")
def load(
    node: NodeArgument,
    file: Annotated[Path, typer.Argument(help="A file as ropeway param dump prints it.", show_default=False)],
    no_use_wildcard: Annotated[
        bool, typer.Option("--no-use-wildcard", help="Leave out what the file has for /** and the like.")
    ] = False,
    graph: GraphOption = "",
    timeout: TimeoutOption = 5.0,
    as_json: JsonOption = False,
) -> None:
    """Set the parameters of NODE that FILE has for it, each on its own; exit status 1 if one was refused."""
    full = place_name(node)
    document = _read(file)

    async def work(session: OpenGraph) -> dict[str, str | None]:
        parameters = parameters_of(session, full, timeout)
        if isinstance(parameters, AtMaster):
            if not isinstance(document, Mapping):
                fail(f"{file} is not a file of parameters: expected {{name: value}}", 2)
            return await parameters.set({str(name): value for name, value in document.items()})
        try:
            values = parameters_for(document, full, wildcards=not no_use_wildcard)
            for name, value in values.items():
                _check(name, value)
        except ValueError as error:
            fail(f"{file}: {error}", 2)
        if not values:
            fail(f"{file} has nothing for {full}; it must stand below {full}: or a pattern such as /**:", 2)
        return await parameters.set(values)

    refused = ask(graph, full, timeout, work)
    if as_json:
        print_json({"node": full, "parameters": [_told(name, why) for name, why in refused.items()]})
    else:
        for name, why in refused.items():
            if why is None:
                answer(f"Set parameter {name} successful")
            else:
                complain(f"Setting parameter {name} failed: {why or 'no reason'}")
    if any(why is not None for why in refused.values()):
        raise typer.Exit(1)


def _check(name: str, value: Any) -> None:
    """Raise ``ValueError`` for what no parameter can be."""
    try:
        type_of(value)
    except ValueMismatch as error:
        raise ValueError(f"{name}: {plain(value)!r} cannot be a parameter: {error}") from None


def _told(name: str, why: str | None) -> dict[str, Any]:
    return {"name": name, "set": why is None, "reason": why or ""}
