"""``ropeway demo-anycast``: a robot that has two edges and a cloud, and is answered by the best of them.

While it runs the link to the machine in use is made slow, and later good again. A table shows whom the robot asks; at
the end the latency of every frame is drawn over time, with the changes marked.
"""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, complain, print_json
from ropeway.cli.loop import run

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("demo-anycast")
def demo(
    output: Annotated[Path, typer.Option("--output", "-o", help="Where latencies are drawn (PNG).")] = Path(
        "anycast.png"
    ),
    seconds: Annotated[float, typer.Option("--for", min=6.0, help="How long it runs, in seconds.")] = 15.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print only the summary, as JSON.")] = False,
) -> None:
    """Slow the link to the machine in use; exit status 0 if another took over and frames were answered throughout."""
    from ropeway.cli.demo_anycast.drawing import draw
    from ropeway.cli.demo_anycast.scene import play

    story = run(play(seconds, live=not as_json, say=(lambda text: None) if as_json else complain))
    drawn = draw(story, output)
    summary = story.summary()
    if as_json:
        print_json({**summary, "drawn": str(output) if drawn else None})
    else:
        answer(f"{summary['answered']} of {summary['frames']} frames answered, {summary['late']} of them late")
        for at_s, machine, why in story.changes:
            answer(f"{at_s:6.2f} s  {machine}: {why}")
        answer(f"The latencies are in {output}." if drawn else "Nothing is drawn: pip install 'ropeway[demo]'.")
    raise typer.Exit(0 if summary["ok"] else 1)
