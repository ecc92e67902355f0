"""The options by which any verb on a graph says who asks: ``--token --ca --certificate --key``.

They belong to every verb that has ``--graph``: ``lazy_group`` adds them, and ``open_session`` uses what was given.
"""

from __future__ import annotations

from contextvars import ContextVar
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer
import typer.main

from ropeway.cli.console import fail
from ropeway.errors import ConfigError

if TYPE_CHECKING:
    import ssl

__all__ = ["GraphCredentials", "add_credentials", "graph_credentials"]

_TLS: Final = ("wss://", "iorts://", "mqtts://")
_TOKENS: Final = ("ws://", "wss://", "iort://", "iorts://")


@dataclass(frozen=True)
class GraphCredentials:
    """Holds what the options were given, ``""`` where they were not."""

    token: str = ""
    ca: str = ""
    certificate: str = ""
    key: str = ""

    def options(self, url: str) -> dict[str, Any]:
        """Return the options of the graph at ``url``; end with a sentence where it takes none of them."""
        addresses = url.split(",")
        encrypted = any(address.startswith(_TLS) for address in addresses)
        out: dict[str, Any] = {}
        if self.ca or self.certificate or self.key:
            if not encrypted:
                fail("--ca, --certificate and --key are for wss://, iorts:// and mqtts:// graphs; -g names none", 2)
            out["ssl_context"] = self._context()
        if self.token and any(address.startswith(_TOKENS) for address in addresses):
            if url.startswith("iort"):
                out["token"] = self.token
            else:
                out["headers"] = {"Authorization": f"Bearer {self.token}"}
        return out

    def _context(self) -> ssl.SSLContext | None:
        from ropeway.gateway.config.tls_model import RemoteTls
        from ropeway.gateway.tls import client_context

        if self.key and not self.certificate:
            fail("--key needs --certificate", 2)
        for option, path in (("ca", self.ca), ("certificate", self.certificate), ("key", self.key)):
            if path and not Path(path).is_file():
                fail(f"--{option}: there is no file {path}", 2)
        tls = RemoteTls(ca=self.ca or None, certificate=self.certificate or None, key=self.key or None, verify=True)
        try:
            return client_context(tls, "tls")
        except ConfigError as error:
            fail(str(error), 2)


_given: ContextVar[GraphCredentials] = ContextVar("credentials")


def graph_credentials() -> GraphCredentials:
    """Return what the verb that runs was given."""
    return _given.get(GraphCredentials())


def _keep(name: str) -> Any:
    def kept(value: str) -> str:
        _given.set(replace(graph_credentials(), **{name: value}))
        return value

    return kept


def _option(name: str, help: str, envvar: str | None = None) -> Any:
    return typer.Option(
        f"--{name}", envvar=envvar, help=help, show_default=False, expose_value=False, callback=_keep(name)
    )


_SHOWN_TO_OTHERS: Final = "The token to show; others of this machine see it unless it is in ROPEWAY_TOKEN."


def _verb(
    token: Annotated[str, _option("token", _SHOWN_TO_OTHERS, "ROPEWAY_TOKEN")] = "",
    ca: Annotated[str, _option("ca", "File of the authorities to trust, for wss, iorts and mqtts.")] = "",
    certificate: Annotated[
        str, _option("certificate", "File of the certificate to show, for wss, iorts and mqtts.")
    ] = "",
    key: Annotated[str, _option("key", "File of its key.")] = "",
) -> None:
    """Have the options that ``add_credentials`` gives to others."""


@cache
def _options() -> tuple[Any, ...]:
    app = typer.Typer(add_completion=False)
    app.command()(_verb)
    return tuple(typer.main.get_command(app).params)


def add_credentials(command: Any) -> None:
    """Give a command that has ``--graph`` the options, but for those that it has itself."""
    names = {param.name for param in command.params}
    if "graph" in names:
        command.params.extend(option for option in _options() if option.name not in names)
