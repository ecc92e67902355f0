"""``ropeway bag info``: what a recording has."""

from __future__ import annotations

import time
from pathlib import Path
from typing import Annotated, Any

import typer

from ropeway.cli.console import answer, complain, print_json
from ropeway.cli.session import JsonOption, TypesOption, known_types
from ropeway.recording.bag import Bag, BagTopic

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("info")
def info(
    bag: Annotated[Path, typer.Argument(help="An MCAP file, a rosbag2 directory or a ROS 1 bag.", show_default=False)],
    types: TypesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Show the topics of the recording BAG, with their types, counts and rates."""
    with Bag(bag, known_types(types)) as opened:
        files = sorted(path for path in bag.rglob("*") if path.is_file()) if bag.is_dir() else [bag]
        found: dict[str, Any] = {
            "files": [str(path) for path in files],
            "bytes": sum(path.stat().st_size for path in files),
            "start_ns": opened.start_ns,
            "duration_s": round(opened.duration_s, 6),
            "messages": sum(topic.count for topic in opened.topics),
            "topics": [_row(topic, opened.duration_s) for topic in sorted(opened.topics, key=lambda one: one.name)],
            "notes": opened.notes,
        }
    if as_json:
        print_json(found)
        return
    start_s = found["start_ns"] / 1e9
    began, ended = (_date(at_s) for at_s in (start_s, start_s + found["duration_s"]))
    answer(f"Files:     {', '.join(found['files'])}")
    answer(f"Size:      {found['bytes'] / 1e6:.1f} MB")
    answer(f"Duration:  {found['duration_s']:.3f} s, from {began} to {ended}")
    answer(f"Messages:  {found['messages']}")
    width = max((len(row["name"]) for row in found["topics"]), default=0)
    kind = max((len(row["type"]) for row in found["topics"]), default=0)
    for row in found["topics"]:
        rate = "" if row["rate_hz"] is None else f"  {row['rate_hz']:8.2f} Hz"
        latched = "  latched" if row["qos"]["durability"] == "transient_local" else ""
        answer(f"  {row['name']:{width}}  {row['type']:{kind}}  {row['count']:8}{rate}{latched}")
        if row["problem"]:
            complain(f"{row['name']} cannot be played: {row['problem']}")
    for note in found["notes"]:
        complain(note)


def _date(at_s: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(at_s))


def _row(topic: BagTopic, duration_s: float) -> dict[str, Any]:
    rate = round((topic.count - 1) / duration_s, 3) if duration_s and topic.count > 1 else None
    return {
        "name": topic.name,
        "type": topic.type,
        "count": topic.count,
        "rate_hz": rate,
        "qos": topic.qos.to_json(),
        "problem": topic.problem,
    }
