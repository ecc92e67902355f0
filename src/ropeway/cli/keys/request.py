"""``ropeway keys request``: a key that never leaves its machine, and a request to certify it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.session import JsonOption
from ropeway.errors import IdentityError
from ropeway.networks.overlay.crypto.identity import private_pem, write_private
from ropeway.networks.overlay.fleet import ALGORITHMS, make_request, new_key

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def request(
    name: Annotated[str, typer.Argument(help="The name of this machine in the fleet.", show_default=False)],
    algorithm: Annotated[
        str, typer.Option("--algorithm", help=f"The algorithm of the key: {' or '.join(ALGORITHMS)}.")
    ] = "ed25519",
    as_json: JsonOption = False,
) -> None:
    """Make NAME.key, which stays here, and NAME.csr, to be signed where the fleet is (keys sign)."""
    key = new_key(algorithm)
    csr = make_request(name, key)
    key_path, csr_path = Path(f"{name}.key"), Path(f"{name}.csr")
    write_private(key_path, private_pem(key))
    try:
        csr_path.write_text(csr)
    except OSError as error:
        raise IdentityError(str(csr_path), f"it cannot be written: {error.strerror}") from error
    if as_json:
        print_json({"key": str(key_path), "request": str(csr_path)})
    else:
        answer(
            f"Have {csr_path} signed: ropeway keys sign {csr_path}. Then: ropeway keys join {name}.signed {key_path}"
        )
