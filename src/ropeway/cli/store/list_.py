"""``ropeway store list``: which topics have a last value."""

from __future__ import annotations

from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.session import JsonOption
from ropeway.cli.store.source import AtOption, CaOption, TokenOption, find_source, key_of

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("list")
def list_values(
    pattern: Annotated[str, typer.Argument(help="SYSTEM or SYSTEM/TOPIC; * stands for anything.")] = "*/*",
    at: AtOption = "http://127.0.0.1:9090",
    token: TokenOption = "",
    ca: CaOption = "",
    as_json: JsonOption = False,
) -> None:
    """List topics with the age, the size and the writer of their last value."""
    source = find_source(at, token, ca)
    try:
        for value in source.values(*key_of(pattern)):
            if as_json:
                print_json(value)
                continue
            name = f"{value['system']}/{value['topic']}"
            age = value.get("age_s", 0.0)
            answer(f"{name:<40} {_ago(age):>10}  {value['type'] or 'text'}  by {value['origin'] or '?'}")
    finally:
        source.close()


def _ago(seconds: float) -> str:
    for unit, length in (("d", 86400), ("h", 3600), ("min", 60)):
        if seconds >= 2 * length:
            return f"{seconds / length:.0f} {unit} ago"
    return f"{seconds:.1f} s ago"
