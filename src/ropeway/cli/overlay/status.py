"""``ropeway overlay status``: who is there, by which path, and what was refused."""

from __future__ import annotations

from typing import Any, Final

import typer

from ropeway.cli.console import answer, print_json
from ropeway.cli.loop import run
from ropeway.cli.name import IdentityOption
from ropeway.cli.overlay.common import RoutersOption, joined
from ropeway.cli.session import JsonOption, SpinOption

__all__ = ["app"]

_CLOCK_S: Final = 5.0  # clocks that differ by less serve all the same

app = typer.Typer(add_completion=False)


@app.command()
def status(
    identity: IdentityOption,
    router: RoutersOption = None,
    spin_time: SpinOption = 3.0,
    as_json: JsonOption = False,
) -> None:
    """Join for a moment and say who is there. What a running gateway refused stands in its own status (run --json)."""

    async def look() -> dict[str, Any]:
        async with joined(identity, router, spin_time) as graph:
            found = graph.node.status()
            for row in found["gateways"]:
                row["rtt_ms"] = await graph.node.rtt_ms(bytes.fromhex(row["gateway"]))
            return found

    found = run(look())
    if as_json:
        print_json(found)
        return
    answer(
        f"{found['name']} of fleet {found['fleet']}, until {found['expires'][:10]}; {len(found['routers'])} router(s)"
    )
    if found["trouble"]:
        answer(f"  {found['trouble']}")
    for row in found["gateways"]:
        rtt = "no answer" if row["rtt_ms"] is None else f"{row['rtt_ms']:.1f} ms"
        clock = f", its clock {row['clock_ahead_s']:+.0f} s from ours" if abs(row["clock_ahead_s"]) > _CLOCK_S else ""
        answer(f"  {row['name']:<24}{row['path']:<8}{rtt:>12}{row['names']:>8} names{clock}")
    for row in found["refused"]:
        answer(f"  refused {row['count']} x of {row['who']}: {row['reason']}")
