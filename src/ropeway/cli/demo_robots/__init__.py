"""``ropeway demo-robots``: five robots that are alike, in one picture.

Each has a network and a gateway of its own, and calls its frames ``odom``, ``base_link`` and ``camera``. In the cloud
their transforms meet on ``/tf`` and ``/tf_static``, under a name of each, and one reader that comes late draws them.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, complain, print_json
from ropeway.cli.loop import run

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("demo-robots")
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Where the robots are drawn (PNG).")] = Path(
        "robots.png"
    ),
    seconds: Annotated[float, typer.Option("--for", min=1.0, help="How long they drive, in seconds.")] = 6.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print only the summary, as JSON.")] = False,
) -> None:
    """Drive five robots that are alike; exit status 0 if all of them are in one picture."""
    from ropeway.cli.demo_robots.drawing import draw
    from ropeway.cli.demo_robots.scene import ROBOTS, play

    picture = run(play(seconds, say=(lambda text: None) if as_json else complain))
    drawn = draw(picture, output)
    frames = {name: sorted(picture.mounted[name]) for name in ROBOTS}
    robots = [{"robot": name, "poses": len(picture.tracks[name]), "static_frames": frames[name]} for name in ROBOTS]
    complete = all(picture.tracks[name] and frames[name] for name in ROBOTS)
    if as_json:
        print_json({"ok": complete, "robots": robots, "drawn": str(output) if drawn else None})
    else:
        for name in ROBOTS:
            answer(f"{name}: {len(picture.tracks[name])} poses on /tf, {', '.join(frames[name])} on /tf_static")
        answer(f"The robots are in {output}." if drawn else "Nothing is drawn: pip install 'ropeway[demo]'.")
    raise typer.Exit(0 if complete else 1)
