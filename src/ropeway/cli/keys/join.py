"""``ropeway keys join``: put a signed bundle and the key that stayed here together."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.keys.common import about, describe
from ropeway.cli.session import JsonOption
from ropeway.networks.overlay.crypto.identity import Identity, read_bundle, write_private
from ropeway.networks.overlay.crypto.material import check_private, read_material_text

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def join(
    signed: Annotated[Path, typer.Argument(help="NAME.signed, as keys sign made it.", show_default=False)],
    key: Annotated[Path, typer.Argument(help="NAME.key, as keys request made it.", show_default=False)],
    output: Annotated[
        Path | None, typer.Option("--output", help="The file; by default, NAME.ropeway.", show_default=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Write NAME.ropeway, the bundle of this machine."""
    found = dict(read_bundle(read_material_text(signed), str(signed)))
    found["key"] = read_material_text(key)
    check_private(key)
    text = json.dumps(found, indent=1) + "\n"
    identity = Identity.parse(text, str(signed))
    path = output or Path(f"{identity.name}.ropeway")
    write_private(path, text)
    if as_json:
        print_json({"file": str(path), **about(identity.certificate)})
    else:
        answer(describe(identity.certificate))
        answer(f"{path} is the bundle of this machine; {key} and {signed} may be removed.")
