"""``ropeway config``: check a configuration, describe its format, or change that of a running gateway."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, complain, print_json
from ropeway.cli.running_config import add_to
from ropeway.errors import ConfigError

__all__ = ["app"]

app = typer.Typer(
    name="config",
    help="Check a configuration, or change that of a running gateway.",
    no_args_is_help=True,
    add_completion=False,
)


@app.command()
def check(
    file: Annotated[Path, typer.Argument(help="A configuration, JSON or YAML.", show_default=False)],
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Check FILE: print its routes, or every fault with its path. The exit status is 2 where there is a fault."""
    from ropeway.gateway.config.config import load
    from ropeway.gateway.config.type_hints import known_types, type_hints
    from ropeway.planning.configured import unfitting

    try:
        config = load(file)
    except ConfigError as error:
        if as_json:
            problems = [{"path": path, "problem": text} for path, text in error.problems]
            print_json({"valid": False, "file": str(file), "problems": problems})
        else:
            for line in str(error).splitlines():
                complain(line)
            count = len(error.problems)
            complain(f"{count} problem{'s' if count > 1 else ''}; nothing would start.")
        raise typer.Exit(2) from None
    routes = config.routes()
    hints = type_hints(config, known_types(config)) + [("remotes", sentence) for sentence in unfitting(config)]
    if as_json:
        shown = [
            {
                "path": route.path,
                "operation": route.operation,
                "name": route.name,
                "remote_name": route.remote_name,
                "type": route.type,
                "remote": route.remote.address,
                "graph": route.graph,
                "encoding": route.delivery.encoding,
            }
            for route in routes
        ]
        print_json({"valid": True, "file": str(file), "config": config.to_json(), "routes": shown, **_warned(hints)})
        return
    for route in routes:
        far = "" if route.remote_name == route.name else f" as {route.remote_name}"
        arrow = "<-" if route.operation.startswith(("subscribe", "reserve")) else "->"
        answer(f"{route.path}: {route.name} [{route.type}] {arrow} {route.remote.address}{far}")
    for path, hint in hints:
        complain(f"{path}: {hint}")
    asleep = sum(not remote.active for remote in config.remotes)
    also = f", {asleep} not active" if asleep else ""
    answer(f"{file} is valid: {len(config.remotes)} remote(s){also}, {len(routes)} route(s).")


def _warned(hints: list[tuple[str, str]]) -> dict[str, list[dict[str, str]]]:
    return {"warnings": [{"path": path, "warning": hint} for path, hint in hints]} if hints else {}


@app.command()
def schema(
    as_json: Annotated[bool, typer.Option("--json", help="On one line; the schema is JSON in any case.")] = False,
) -> None:
    """Print the JSON Schema of configurations, for editors."""
    from ropeway.gateway.config.config import Config

    made = Config.schema()
    if as_json:
        print_json(made)
    else:
        answer(json.dumps(made, indent=2))


add_to(app)
