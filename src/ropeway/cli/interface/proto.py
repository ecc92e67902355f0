"""``ropeway interface proto``: a message with the values that it has by itself, to copy and change."""

from __future__ import annotations

from typing import Annotated, Final

import orjson
import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.interface.common import AskedGraphOption, InterfaceArgument, find_interface
from ropeway.cli.session import JsonOption, TypesOption
from ropeway.cli.topic.render import Style, as_yaml, pick, shown

__all__ = ["app"]

app = typer.Typer(add_completion=False)

_SENT: Final = {"msg": "", "srv": "_Request", "action": "_Goal"}


@app.command("proto")
def proto(
    type: InterfaceArgument,
    no_quotes: Annotated[bool, typer.Option("--no-quotes", help="Without the quotes that a shell needs.")] = False,
    graph: AskedGraphOption = "",
    types: TypesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Print a message of TYPE with its default values in YAML: of a service the request, of an action the goal."""
    registry, full = find_interface(type, graph, types)
    codec = registry.codec(full + _SENT[full.split("/")[1]])
    payload = codec.from_json({})
    if as_json:
        print_json({"name": codec.type, "msg": orjson.Fragment(codec.json(payload))})
        return
    style = Style(truncate=None)
    whole = pick(registry, codec.type, codec.decode(payload), "")
    text = as_yaml(shown(registry, whole, style), style).rstrip("\n")
    answer(text if no_quotes else f'"{text}\n"')
