"""``ropeway overlay list``: what is advertised."""

from __future__ import annotations

from typing import Any

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.loop import run
from ropeway.cli.name import IdentityOption
from ropeway.cli.overlay.common import RoutersOption, joined
from ropeway.cli.session import JsonOption, SpinOption

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("list")
def list_names(
    identity: IdentityOption,
    router: RoutersOption = None,
    spin_time: SpinOption = 3.0,
    as_json: JsonOption = False,
) -> None:
    """List every publisher, subscription, service and client of the members, with its global name."""

    async def look() -> list[dict[str, Any]]:
        async with joined(identity, router, spin_time) as graph:
            return [
                {
                    "kind": advert.kind,
                    "name": advert.name,
                    "type": advert.type,
                    "global": advert.global_name.hex(),
                    "member": graph.node.owner(advert.gateway),
                    "unique": advert.metadata.unique,
                    "node": advert.node,
                }
                for kind in ("publisher", "subscription", "service", "client")
                for advert in sorted(graph.node.rib.all(kind), key=lambda advert: (advert.name, advert.gateway))
            ]

    rows = run(look())
    for row in rows:
        if as_json:
            print_json(row)
        else:
            answer(f"{row['global'][:16]}  {row['kind']:<13}{row['name']} [{row['type']}] by {row['member']}")
