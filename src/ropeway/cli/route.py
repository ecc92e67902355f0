"""``ropeway route``: single routes of a running gateway."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer
import yaml

from ropeway.cli.asking import CaOption, CertOption, TokenOption, WhereOption
from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.running_config import show_steps

if TYPE_CHECKING:
    from ropeway.control.client import ControlClient

__all__ = ["app"]

app = typer.Typer(
    name="route", help="Add, remove, pause routes of a running gateway.", no_args_is_help=True, add_completion=False
)

JsonOption = Annotated[bool, typer.Option("--json", help="Print the result as JSON.")]
NameArgument = Annotated[
    str, typer.Argument(metavar="NAME", help="The local name, the key, or the path of a route.", show_default=False)
]


@app.command("list")
def list_(
    where: WhereOption = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """List the routes."""
    with _client(where, token, ca, cert) as client:
        found = client.get("/v1/routes")
    if as_json:
        print_json(found)
        return
    for route in found:
        error = f" ({route['error']})" if route["error"] else ""
        answer(f"{route['path']}: {route['name']} [{route['type']}] {route['address']}: {route['state']}{error}")


@app.command()
def add(
    remote: Annotated[str, typer.Argument(help="Address, title or number of a remote.", show_default=False)],
    operation: Annotated[str, typer.Argument(help="publish, subscribe, expose-service, …", show_default=False)],
    name: Annotated[str, typer.Argument(help="The local name.", show_default=False)],
    type: Annotated[str, typer.Argument(help="Its type.", show_default=False)],
    option: Annotated[
        list[str] | None, typer.Option("--option", "-o", help="As in a file: rate_hz=5.", show_default=False)
    ] = None,
    where: WhereOption = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Add a route; everything else goes on. It is remembered over restarts."""
    item: dict[str, Any] = {"name": name, "type": type}
    for text in option or ():
        key, equals, value = text.partition("=")
        if not equals:
            fail(f"--option {text}: expected KEY=VALUE", 2)
        item[key] = yaml.safe_load(value)
    with _client(where, token, ca, cert) as client:
        _say(client.post("/v1/routes", {"remote": remote, "operation": operation, "item": item}), as_json)


@app.command()
def rm(
    name: NameArgument,
    where: WhereOption = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Remove a route."""
    with _client(where, token, ca, cert) as client:
        _say(client.delete(f"/v1/routes/{_key(client, name)}"), as_json)


@app.command()
def pause(
    name: NameArgument,
    where: WhereOption = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Pause a route: it stays in the configuration, and nothing crosses."""
    with _client(where, token, ca, cert) as client:
        _say(client.post(f"/v1/routes/{_key(client, name)}/pause"), as_json)


@app.command()
def resume(
    name: NameArgument,
    where: WhereOption = "",
    as_json: JsonOption = False,
    token: TokenOption = "",
    ca: CaOption = "",
    cert: CertOption = "",
) -> None:
    """Let a paused route go on."""
    with _client(where, token, ca, cert) as client:
        _say(client.post(f"/v1/routes/{_key(client, name)}/resume"), as_json)


def _key(client: ControlClient, name: str) -> str:
    """Return the key of the route that is meant."""
    routes = client.get("/v1/routes")
    found = [route for route in routes if name in (route["key"], route["path"], route["name"], route["name"][1:])]
    if len(found) > 1:
        fail(f"several routes are called {name}; name one by its path: {', '.join(route['path'] for route in found)}")
    if not found:
        from ropeway.gateway.config.suggest import did_you_mean

        fail(f"there is no route {name} here{did_you_mean(name, [route['name'] for route in routes])}")
    key: str = found[0]["key"]
    return key


def _say(done: dict[str, Any], as_json: bool) -> None:
    if as_json:
        print_json(done)
    elif done["applied"]:
        show_steps(done)
    else:
        answer("Nothing to do: it is so already.")


def _client(where: str, token: str, ca: str, cert: str) -> ControlClient:
    from ropeway.control.client import ControlClient

    return ControlClient.find(where, token=token, ca=ca, cert=cert)
