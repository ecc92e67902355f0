"""``ropeway store get``: a last value."""

from __future__ import annotations

import sys
from base64 import b64decode
from typing import Annotated, Any

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.session import JsonOption
from ropeway.cli.store.source import AtOption, CaOption, TokenOption, find_source, key_of

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("get")
def get(
    name: Annotated[str, typer.Argument(help="SYSTEM/TOPIC, or the name of a ROS topic.", show_default=False)],
    at: AtOption = "http://127.0.0.1:9090",
    history: Annotated[bool, typer.Option("--history", help="Also the values before it, newest first.")] = False,
    raw: Annotated[bool, typer.Option("--raw", help="The raw bytes, without a newline.")] = False,
    token: TokenOption = "",
    ca: CaOption = "",
    as_json: JsonOption = False,
) -> None:
    """Print the last value of a topic."""
    system, topic = key_of(name)
    if "*" in (system, topic):
        fail("name one topic, as PEPPER/cmd_vel; ropeway store list shows them", 2)
    source = find_source(at, token, ca)
    try:
        values = source.get(system, topic, history)
    finally:
        source.close()
    if not values:
        fail(f"no value of {system}/{topic} is there; ropeway store list shows what is")
    for value in values:
        if as_json:
            print_json(value)
        elif raw:
            sys.stdout.buffer.write(_raw(value))
            sys.stdout.buffer.flush()
        else:
            answer(_text(value))


def _raw(value: dict[str, Any]) -> bytes:
    return b64decode(value["base64"]) if "base64" in value else str(value.get("data", "")).encode()


def _text(value: dict[str, Any]) -> str:
    if "message" in value:
        import yaml

        return yaml.safe_dump(value["message"], sort_keys=False, default_flow_style=None).rstrip()
    return value["data"] if "data" in value else f"(base64) {value.get('base64', '')}"
