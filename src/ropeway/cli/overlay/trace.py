"""``ropeway overlay trace``: who has a name, and how it is reached."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated, Any

import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.loop import run
from ropeway.cli.name import IdentityOption
from ropeway.cli.overlay.common import RoutersOption, joined
from ropeway.cli.session import JsonOption, SpinOption, full_name

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command()
def trace(
    name: Annotated[str, typer.Argument(help="A topic or service, or the beginning of a global name.")],
    identity: IdentityOption,
    router: RoutersOption = None,
    spin_time: SpinOption = 3.0,
    as_json: JsonOption = False,
) -> None:
    """Say who advertises NAME, by which path each is reached, who signs and seals, and the round-trip time."""
    wanted = full_name(name) if name.startswith("/") else name.lower()

    async def look() -> list[dict[str, Any]]:
        rows: list[dict[str, Any]] = []
        async with joined(identity, router, spin_time) as graph:
            node = graph.node
            for kind in ("publisher", "service", "subscription", "client"):
                for advert in node.rib.all(kind):
                    if advert.name != wanted and not advert.global_name.hex().startswith(wanted):
                        continue
                    certificate = node.membership.certificate(advert.gateway)
                    rows.append(
                        {
                            "kind": advert.kind,
                            "name": advert.name,
                            "type": advert.type,
                            "global": advert.global_name.hex(),
                            "member": node.owner(advert.gateway),
                            "node": advert.node,
                            "metadata": asdict(advert.metadata),
                            "certificate": "" if certificate is None else certificate.fingerprint.hex(),
                            "path": node.path(advert.gateway),
                            "rtt_ms": await node.rtt_ms(advert.gateway),
                        }
                    )
        return rows

    rows = run(look())
    if not rows:
        fail(f"nobody advertises {name}; ropeway overlay list shows what there is")
    for row in rows:
        if as_json:
            print_json(row)
            continue
        rtt = "no answer" if row["rtt_ms"] is None else f"{row['rtt_ms']:.1f} ms"
        answer(f"{row['kind']} {row['name']} [{row['type']}]")
        answer(f"  global name  {row['global']}")
        if row["node"]:
            answer(f"  node         {row['node']}")
        for key, text in row["metadata"].items():
            if text:
                answer(f"  {key:<13}{text}")
        answer(f"  sealed by    {row['member']} (certificate {row['certificate'][:16]})")
        answer(f"  path         {row['path']}, {rtt}")
