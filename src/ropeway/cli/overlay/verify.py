"""``ropeway overlay verify``: who signed the packets of a capture."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path
from typing import Annotated

import typer
from cryptography import x509

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.session import JsonOption
from ropeway.errors import IdentityError
from ropeway.networks.overlay.audit import verdicts
from ropeway.networks.overlay.crypto.material import read_material, understood
from ropeway.networks.overlay.crypto.trust import Trust

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def verify(
    file: Annotated[Path, typer.Argument(help="A capture, as overlay capture writes it.", show_default=False)],
    ca: Annotated[Path, typer.Option("--ca", help="The authority of the fleet, its ca.pem.", show_default=False)],
    crl: Annotated[
        Path | None, typer.Option("--crl", help="Its revocation list, its crl.pem.", show_default=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Say of each packet of a capture who signed it. Needs no key and no membership, and reads no message.

    Ends with status 1 if a packet was not signed by the publisher under whose name it was put.
    """
    trust = _trust(ca, crl)
    try:
        capture = file.read_text()
    except (OSError, UnicodeDecodeError) as error:
        raise IdentityError(str(file), f"it cannot be read: {error}") from error
    found = list(verdicts(capture, trust))
    for verdict in found:
        if as_json:
            print_json({"verified": not verdict.fault, **asdict(verdict)})
        elif verdict.fault:
            answer(f"{file}:{verdict.line}: NOT verified: {verdict.fault}")
        else:
            last = verdict.first + verdict.messages - 1
            answer(
                f"{file}:{verdict.line}: messages {verdict.first} to {last} of {verdict.name[:16]}, signed by "
                f"{verdict.member} (certificate {verdict.fingerprint[:16]})"
            )
    if not found:
        fail(f"{file}: there is no packet in it")
    if any(verdict.fault for verdict in found):
        raise typer.Exit(1)


def _trust(ca: Path, crl: Path | None) -> Trust:
    with understood(str(ca), "it is not the certificate of an authority"):
        trust = Trust(x509.load_pem_x509_certificate(read_material(ca)))
    if crl is not None:
        with understood(str(crl), "it is not a revocation list of this fleet"):
            trust.update(read_material(crl))
    return trust
