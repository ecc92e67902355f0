"""Options of the verbs that ask a running gateway."""

from __future__ import annotations

from typing import Annotated

import typer

__all__ = ["AsOption", "CaOption", "CertOption", "TokenOption", "WhereArgument", "WhereOption"]

_WHERE = "A running gateway: its name, the path of its socket, or http(s)://host:port; default: the only one here."

WhereArgument = Annotated[str, typer.Argument(metavar="[GATEWAY]", help=_WHERE, show_default=False)]
WhereOption = Annotated[str, typer.Option("--gateway", "-G", envvar="ROPEWAY_GATEWAY", help=_WHERE, show_default=False)]
TokenOption = Annotated[
    str, typer.Option("--token", envvar="ROPEWAY_TOKEN", help="The token to show, over TCP.", show_default=False)
]
CaOption = Annotated[str, typer.Option("--ca", help="File of the authorities to trust, for https.", show_default=False)]
CertOption = Annotated[
    str,
    typer.Option(
        "--cert",
        envvar="ROPEWAY_CERT",
        help="File with a certificate and its key to show, for https; instead of a token.",
        show_default=False,
    ),
]
AsOption = Annotated[
    str, typer.Option("--as", help="Which of the gateways in the file, where it has many.", show_default=False)
]
