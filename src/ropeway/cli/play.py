"""``ropeway play``: publish a recording."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Annotated, Any

import typer

from ropeway.cli.console import complain, fail, print_json
from ropeway.cli.loop import run
from ropeway.cli.patience import patiently
from ropeway.cli.session import (
    GraphOption,
    JsonOption,
    QosDepth,
    QosDurability,
    QosHistory,
    QosProfile,
    QosReliability,
    TypesOption,
    full_name,
    open_session,
    qos_of,
)
from ropeway.qos import DEFAULT, QoS
from ropeway.recording.bag import Bag
from ropeway.recording.player import MAX_GAP_S, Played, play

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("play")
def play_command(
    bag: Annotated[Path, typer.Argument(help="An MCAP file, a rosbag2 directory or a ROS 1 bag.", show_default=False)],
    graph: GraphOption = "",
    rate: Annotated[float, typer.Option("--rate", "-r", min=0.001, help="How much faster than recorded.")] = 1.0,
    loop: Annotated[bool, typer.Option("--loop", "-l", help="Start again at the end.")] = False,
    topics: Annotated[
        list[str] | None,
        typer.Option("--topics", help="Only this topic; may be repeated.", show_default=False),
    ] = None,
    restamp: Annotated[
        bool, typer.Option("--restamp", help="Put the time of sending into headers, so that delays can be measured.")
    ] = False,
    for_s: Annotated[float, typer.Option("--for", min=0.0, help="End after this many seconds; 0: at its end.")] = 0.0,
    wait: Annotated[
        float, typer.Option("--wait", min=0.0, help="Seconds at most to wait until somebody reads each topic.")
    ] = 1.0,
    max_gap: Annotated[
        float,
        typer.Option("--max-gap", min=0.0, help="Seconds of the longest pause that is kept; others become 1 s."),
    ] = MAX_GAP_S,
    start_offset: Annotated[
        float, typer.Option("--start-offset", min=0.0, help="Begin so many seconds into it; latched messages first.")
    ] = 0.0,
    clock: Annotated[
        float, typer.Option("--clock", min=0.0, help="Publish the time of the recording on /clock so often, in Hz.")
    ] = 0.0,
    remap: Annotated[
        list[str] | None, typer.Option("--remap", "-m", help="Another name, as old:=new; may be repeated.")
    ] = None,
    qos_profile: QosProfile = "",
    qos_depth: QosDepth = None,
    qos_history: QosHistory = "",
    qos_reliability: QosReliability = "",
    qos_durability: QosDurability = "",
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress.")] = False,
    types: TypesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Publish the recording BAG at its own pace, as its publishers offered it but for what --qos options say."""
    names = _renamed(remap or [])

    def offer(recorded: QoS) -> QoS:
        asked = qos_of(qos_profile, qos_depth, qos_history, qos_reliability, qos_durability, base=recorded)
        return recorded if asked is None else asked

    offer(DEFAULT)  # what is no policy is told at once
    wanted = [name if name.startswith("/") else f"/{name}" for text in topics or [] for name in text.split(",") if name]

    async def main() -> tuple[Played, dict[str, int], int]:
        async with open_session(graph, types) as session:
            with Bag(bag, session.registry) as opened:
                _tell_problems(opened, wanted, names)
                if start_offset > opened.duration_s:
                    fail(f"{bag} ends {opened.duration_s:.3f} s after its beginning; give a smaller --start-offset", 2)
                with _progress(opened, loop=loop, shown=not quiet and not as_json) as told:
                    played = await play(
                        session.graph,
                        opened,
                        topics=wanted,
                        rate=rate,
                        loop=loop,
                        restamp=restamp,
                        for_s=for_s or None,
                        wait_s=wait,
                        max_gap_s=max_gap,
                        start_s=start_offset,
                        offer=offer,
                        clock_hz=clock,
                        rename=lambda name: names.get(name, name),
                        told=told,
                        patiently=patiently,
                    )
                return played, dict(opened.dropped), _held(opened, wanted)

    began = time.monotonic()
    played, dropped, held = run(main())
    seconds = time.monotonic() - began
    if as_json:
        print_json(
            {
                "messages": played.messages,
                "bytes": played.bytes,
                "seconds": round(seconds, 3),
                "topics": dict(played.by_topic),
                "dropped": dropped,
            }
        )
    elif not quiet:
        topics_played = len(played.by_topic)
        complain(
            f"Played {played.messages} messages of {topics_played} topics, "
            f"{played.bytes / 1e6:.1f} MB, in {seconds:.1f} s."
        )
    if played.jumps and not quiet:
        complain(
            f"Pauses of up to {_span(played.longest_jump_s)} were played as 1 s ({played.jumps} of them); "
            "--max-gap keeps longer ones."
        )
    if dropped:
        complain(f"{sum(dropped.values())} messages were left out, as they are not of their type: {', '.join(dropped)}")
    if held and not played.messages and not for_s:
        fail(f"none of the {held} messages in {bag} could be played")


def _tell_problems(bag: Bag, wanted: list[str], renamed: Iterable[str]) -> None:
    names = {topic.name for topic in bag.topics}
    for name in (*wanted, *renamed):
        if name not in names:
            fail(f"{bag.path} has no topic {name}; it has {', '.join(sorted(names)) or 'none'}")
    chosen = [topic for topic in bag.topics if not wanted or topic.name in wanted]
    for topic in chosen:
        if topic.problem:
            complain(f"{topic.name} is not played: {topic.problem}")
    if chosen and all(topic.problem for topic in chosen):
        fail(f"nothing in {bag.path} can be played")


def _renamed(remap: list[str]) -> dict[str, str]:
    """Return the new names by the old ones, or end with a sentence."""
    names = {}
    for text in remap:
        old, between, new = text.partition(":=")
        if not between:
            fail(f"{text!r} is no other name; write --remap /old:=/new", 2)
        names[full_name(old)] = full_name(new)
    return names


def _held(bag: Bag, wanted: list[str]) -> int:
    """Return how many messages the recording has of the topics to play."""
    return sum(topic.count for topic in bag.topics if not wanted or topic.name in wanted)


def _span(seconds: float) -> str:
    """Write a duration for people."""
    for unit, size in (("years", 31_557_600), ("days", 86_400), ("h", 3_600)):
        if seconds >= 2 * size:
            return f"{seconds / size:.0f} {unit}"
    return f"{seconds:.0f} s"


def _progress(bag: Bag, *, loop: bool, shown: bool) -> AbstractContextManager[Callable[[Played], None]]:
    """Show a progress bar on stderr, if that is a terminal."""
    if not shown or not sys.stderr.isatty():
        return nullcontext(lambda played: None)
    return _Bar(bag, loop=loop)


class _Bar:
    """The bar itself, redrawn a few times a second."""

    def __init__(self, bag: Bag, *, loop: bool) -> None:
        from rich.console import Console
        from rich.progress import BarColumn, Progress, TextColumn

        self._progress = Progress(
            TextColumn("{task.description}"),
            BarColumn(),
            TextColumn(
                "{task.completed:.1f} of {task.total:.1f} s, {task.fields[messages]} messages{task.fields[round]}"
            ),
            console=Console(stderr=True),
            transient=True,
        )
        self._loop = loop
        self._task = self._progress.add_task(bag.path.name, total=bag.duration_s, messages=0, round="")
        self._due = 0.0

    def __enter__(self) -> Callable[[Played], None]:
        self._progress.start()
        return self._told

    def __exit__(self, *_: Any) -> None:
        self._progress.stop()

    def _told(self, played: Played) -> None:
        now = time.monotonic()
        if now < self._due:
            return
        self._due = now + 0.2
        lap = f", round {played.rounds + 1}" if self._loop else ""
        self._progress.update(self._task, completed=played.position_s, messages=played.messages, round=lap)
