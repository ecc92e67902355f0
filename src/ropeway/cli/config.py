"""``ropeway config``: check a configuration, describe its format, or change that of a running gateway."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ropeway.cli.asking import AsOption
from ropeway.cli.console import answer, complain, print_json
from ropeway.cli.running_config import add_to
from ropeway.errors import ConfigError

if TYPE_CHECKING:
    from ropeway.gateway.config.config import Config
    from ropeway.gateway.config.fleet import GatewayFleet

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
    part: AsOption = "",
    as_json: Annotated[bool, typer.Option("--json", help="Print the result as JSON.")] = False,
) -> None:
    """Check FILE: print its routes, or every fault with its path. The exit status is 2 where there is a fault.

    Where FILE has many gateways, all are checked, and whether they fit together.
    """
    from ropeway.gateway.config.document import read_file
    from ropeway.gateway.config.fleet import is_fleet, load_one, read_fleet

    try:
        document = read_file(file)
        if not part and is_fleet(document):
            _say_fleet(file, read_fleet(document, str(file), directory=file.parent), as_json)
        else:
            _say_one(file, load_one(file, part), as_json)
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


def _say_one(file: Path, config: Config, as_json: bool) -> None:
    hints = _hints(config)
    if as_json:
        print_json({"valid": True, "file": str(file), **_shown(config), **_warned(hints)})
        return
    _print_routes(config, "")
    for path, hint in hints:
        complain(f"{path}: {hint}")
    answer(f"{file} is valid: {_counted(config)}.")


def _say_fleet(file: Path, fleet: GatewayFleet, as_json: bool) -> None:
    hints = [
        (f"gateways.{name}.{path}", hint) for name, config in fleet.members.items() for path, hint in _hints(config)
    ]
    hints += [(found.path, found.text) for found in fleet.findings()]
    if as_json:
        gateways = {name: _shown(config) for name, config in fleet.members.items()}
        print_json({"valid": True, "file": str(file), "gateways": gateways, **_warned(hints)})
        return
    for name, config in fleet.members.items():
        answer(f"{name}: {_counted(config)}")
        _print_routes(config, "  ")
    for path, hint in hints:
        complain(f"{path}: {hint}")
    answer(f"{file} is valid: {len(fleet.members)} gateways.")


def _hints(config: Config) -> list[tuple[str, str]]:
    from ropeway.gateway.config.group_hints import group_hints
    from ropeway.gateway.config.type_hints import known_types, type_hints
    from ropeway.planning.configured import unfitting

    hints = [*type_hints(config, known_types(config)), *group_hints(config)]
    return hints + [("remotes", sentence) for sentence in unfitting(config)]


def _counted(config: Config) -> str:
    asleep = sum(not remote.active for remote in config.remotes)
    also = f", {asleep} not active" if asleep else ""
    return f"{len(config.remotes)} remote(s){also}, {len(config.routes())} route(s)"


def _print_routes(config: Config, indent: str) -> None:
    for route in config.routes():
        far = "" if route.remote_name == route.name else f" as {route.remote_name}"
        arrow = "<-" if route.operation.startswith(("subscribe", "reserve")) else "->"
        answer(f"{indent}{route.path}: {route.name} [{route.type}] {arrow} {route.remote.address}{far}")


def _shown(config: Config) -> dict[str, Any]:
    shown = [
        {
            "path": route.path,
            "operation": route.operation,
            "name": route.name,
            "remote_name": route.remote_name,
            "type": route.type,
            "remote": route.remote.address,
            "graph": route.graph,
            "encoding": route.options.delivery.encoding,
        }
        for route in config.routes()
    ]
    return {"config": config.to_json(), "routes": shown}


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
