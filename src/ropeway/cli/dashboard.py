"""``ropeway dashboard``: running gateways in a browser."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ropeway.cli.asking import CaOption, TokenOption
from ropeway.cli.console import answer, fail
from ropeway.cli.logs import LEVELS, set_up
from ropeway.cli.loop import run

if TYPE_CHECKING:
    from ropeway.control.client import ControlTarget

__all__ = ["app"]

log = logging.getLogger("ropeway.dashboard")

app = typer.Typer(add_completion=False)


@app.command("dashboard")
def dashboard_command(
    gateways: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[GATEWAY]...",
            help="Names, paths of sockets, or http(s)://host:port; default: all that run on this machine.",
            show_default=False,
        ),
    ] = None,
    address: Annotated[str, typer.Option("--address", help="Where to listen.")] = "127.0.0.1",
    port: Annotated[int, typer.Option("--port", "-p", min=0, max=65535, help="0 for any.")] = 8788,
    key_file: Annotated[
        Path | None,
        typer.Option("--key-file", help="File with the key to log in with; default: a new one.", show_default=False),
    ] = None,
    insecure: Annotated[bool, typer.Option("--insecure", help="Let everybody in without a login.")] = False,
    host_name: Annotated[
        list[str] | None,
        typer.Option("--host-name", help="A name by which browsers find this machine.", show_default=False),
    ] = None,
    certfile: Annotated[str, typer.Option(help="The certificate chain, PEM; makes it https.", show_default=False)] = "",
    keyfile: Annotated[str, typer.Option(help="The key of the certificate, PEM.", show_default=False)] = "",
    token: TokenOption = "",
    ca: CaOption = "",
    browse: Annotated[bool, typer.Option("--open", help="Open it in a browser.")] = False,
    log_level: Annotated[str, typer.Option("--log-level", help=f"{', '.join(LEVELS)}.")] = "warning",
) -> None:
    """Serve pages about running gateways: a map, routes, topics, driving, configuration, clients and more.

    Whoever opens the address that is printed may do what you may. Others log in with a token of a gateway, and may do
    what its role allows. Other machines can connect with --address 0.0.0.0, which needs --key-file or --insecure.
    """
    from ropeway.dashboard.server import DashboardSettings, serve

    set_up(log_level)
    if bool(certfile) != bool(keyfile):
        fail("--certfile and --keyfile belong together", 2)
    for option, file in (("--certfile", certfile), ("--keyfile", keyfile)):
        if file and not Path(file).is_file():
            fail(f"{option} {file}: there is no such file", 2)
    key = _key(key_file)
    if not (_is_loopback(address) or key or insecure):
        fail(f"--address {address} lets other machines in: choose a key with --key-file, or say --insecure", 2)
    if not (_is_loopback(address) or certfile):
        log.warning("keys and tokens are sent unencrypted to %s; --certfile and --keyfile encrypt them", address)
    settings = DashboardSettings(
        targets=_targets(gateways, token, ca),
        host=address,
        port=port,
        key=key,
        insecure=insecure,
        names=host_name or (),
        certificate=certfile,
        certificate_key=keyfile,
    )

    def ready(url: str) -> None:
        answer(url)
        if browse:
            import webbrowser

            webbrowser.open(url)

    run(serve(settings, ready))


def _targets(gateways: list[str] | None, token: str, ca: str) -> list[ControlTarget] | None:
    from ropeway.control.client import find_target

    return [find_target(where, token=token, ca=ca) for where in gateways] if gateways else None


def _key(file: Path | None) -> str:
    if file is None:
        return ""
    try:
        key = file.read_text().strip()
    except (OSError, UnicodeDecodeError) as error:
        fail(f"--key-file {file}: {error}", 2)
    if len(key) < 16:
        fail(f"--key-file {file}: a key has at least 16 characters", 2)
    return key


def _is_loopback(address: str) -> bool:
    from ropeway.gateway.config.address import is_loopback

    return is_loopback(f"ws://[{address}]" if ":" in address else f"ws://{address}")
