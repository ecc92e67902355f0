"""``ropeway demo-iort``: one command to robots that differ, as in the IoRT paper's second test.

A node that publishes text packets drives a robot of ROS 2, one of ROS 1 and one like the paper's Alice, at once:
forward 2 s, a turn of about 45 degrees, forward 1 s, a turn of about 180 degrees. Their tracks are drawn side by side.
"""

from __future__ import annotations

import math
import tempfile
from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, complain, print_json
from ropeway.cli.loop import run

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("demo-iort")
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Where the tracks are drawn (PNG).")] = Path(
        "tracks.png"
    ),
    keyboard: Annotated[
        bool, typer.Option("--keyboard", help="Drive with the arrow keys or WASD; q ends.", show_default=False)
    ] = False,
    ros1: Annotated[bool, typer.Option("--ros1/--no-ros1", help="Include the ROS 1 robot.")] = True,
    domain: Annotated[int, typer.Option("--domain", min=0, max=232, help="The DDS domain of the ROS 2 robot.")] = 73,
    as_json: Annotated[bool, typer.Option("--json", help="Print only the summary, as JSON.")] = False,
) -> None:
    """Drive three robots that differ with one command; exit status 0 if all did what they were told."""
    from ropeway.cli.demo_iort.drive import drive
    from ropeway.cli.demo_iort.robots import ros1_missing
    from ropeway.cli.demo_iort.tracks import draw, summary

    missing = ros1_missing() if ros1 else ""
    if missing:
        complain(f"ropeway: the ROS 1 robot is left out: {missing}")
    say = (lambda text: None) if as_json else complain
    with tempfile.TemporaryDirectory(prefix="ropeway-demo-") as directory:
        tracks = run(drive(Path(directory), domain, with_ros1=ros1 and not missing, keyboard=keyboard, say=say))
    drawn = draw(tracks, output)
    rows = [summary(name, track) for name, track in tracks.items()]
    ok = keyboard or all(row["ok"] for row in rows)
    if as_json:
        print_json({"ok": ok, "robots": rows, "drawn": str(output) if drawn else None})
    else:
        for row in rows:
            turns = " and ".join(f"{math.fabs(turn):.0f}" for turn in row["turns_deg"])
            answer(f"{row['robot']:<12} {row['metres']:.2f} m, turned {turns or 'not at all'} degrees")
        answer(f"The tracks are in {output}." if drawn else "The tracks are not drawn: pip install 'ropeway[demo]'.")
    raise typer.Exit(0 if ok else 1)
