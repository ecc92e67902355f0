"""``ropeway store watch``: values as they come."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.session import JsonOption
from ropeway.cli.store.source import AtOption, CaOption, TokenOption, find_source, key_of, shown

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("watch")
def watch(
    pattern: Annotated[str, typer.Argument(help="SYSTEM or SYSTEM/TOPIC; * stands for anything.")] = "*/*",
    at: AtOption = "http://127.0.0.1:9090",
    count: Annotated[int, typer.Option("--count", "-n", min=0, help="End after this many values; 0: never.")] = 0,
    token: TokenOption = "",
    ca: CaOption = "",
    as_json: JsonOption = False,
) -> None:
    """Print the values that are there, then every later one, until Ctrl-C."""
    source = find_source(at, token, ca)
    seen = 0
    try:
        for value in source.watch(*key_of(pattern)):
            if as_json:
                print_json(value)
            elif value.get("removed"):
                answer(f"{value['system']}/{value['topic']} was removed")
            else:
                answer(f"{value['system']}/{value['topic']}  {shown(value)}")
            seen += 1
            if count and seen >= count:
                return
    finally:
        source.close()
