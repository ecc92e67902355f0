"""``ropeway record``: write topics into MCAP files, all the time or around what happens."""

from __future__ import annotations

import asyncio
import re
import signal
import sys
import time
from collections.abc import Callable
from contextlib import AsyncExitStack, suppress
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from ropeway import aio
from ropeway.cli.console import answer, complain, fail, print_json
from ropeway.cli.loop import run
from ropeway.cli.recorder_orders import RecorderOrder, carry_out
from ropeway.cli.session import GraphOption, JsonOption, TypesOption, full_name, open_session
from ropeway.errors import RecordingFailed
from ropeway.recording.clips import ClipRecorder, stamped
from ropeway.recording.condition import Condition
from ropeway.recording.files import McapFiles
from ropeway.recording.graph_recorder import GraphRecorder, TopicChoice
from ropeway.recording.mcap_writer import COMPRESSIONS
from ropeway.recording.ring import Ring
from ropeway.recording.writer import RecordingWriter

__all__ = ["app"]

app = typer.Typer(add_completion=False)

_TOLD_S: Final = 1.0
_MB: Final = 1_000_000


@app.command("record")
def record(
    topics: Annotated[
        list[str] | None,
        typer.Argument(metavar="[TOPICS]...", help="Topics, or patterns such as '/camera/*'.", show_default=False),
    ] = None,
    graph: GraphOption = "",
    everything: Annotated[bool, typer.Option("--all", "-a", help="All topics but hidden ones.")] = False,
    regex: Annotated[str, typer.Option("--regex", "-e", help="Topics that a regular expression finds.")] = "",
    exclude: Annotated[
        list[str] | None, typer.Option("--exclude", "-x", help="Not these (patterns); may be repeated.")
    ] = None,
    include_hidden: Annotated[
        bool, typer.Option("--include-hidden-topics", help="Also names with a part that starts with _.")
    ] = False,
    output: Annotated[
        Path | None, typer.Option("--output", "-o", help="The file; default: recording_DATE-TIME.mcap.")
    ] = None,
    compression: Annotated[
        str, typer.Option("--compression", help=f"Of the files: {', '.join(COMPRESSIONS)}.")
    ] = "none",
    split_mb: Annotated[
        float, typer.Option("--split-size", min=0.0, help="Begin another file after so many MB; 0: never.")
    ] = 0.0,
    split_s: Annotated[
        float, typer.Option("--split-time", min=0.0, help="Begin another file after so many seconds; 0: never.")
    ] = 0.0,
    for_s: Annotated[float, typer.Option("--for", min=0.0, help="End after this many seconds; 0: with Ctrl-C.")] = 0.0,
    ring_s: Annotated[
        float,
        typer.Option("--ring", min=0.0, help="Keep only the last seconds, and write them when something happens."),
    ] = 0.0,
    ring_mb: Annotated[float, typer.Option("--ring-size", min=0.001, help="MB that the ring takes at most.")] = 256.0,
    after_s: Annotated[float, typer.Option("--after", min=0.0, help="Seconds of a clip after what happened.")] = 10.0,
    when: Annotated[
        list[str] | None,
        typer.Option("--when", help="With --ring: '/battery.percentage < 0.2'; may be repeated. So does SIGUSR1."),
    ] = None,
    types: TypesOption = None,
    gateway: Annotated[
        str | None,
        typer.Option(
            "--gateway", "-G", metavar="GATEWAY", help="Show the recorders of a running gateway.", show_default=False
        ),
    ] = None,
    recorder: Annotated[str, typer.Option("--recorder", help="This one of a gateway; default: all.")] = "",
    trigger: Annotated[bool, typer.Option("--trigger", help="Have recorders of a gateway write a clip.")] = False,
    why: Annotated[str, typer.Option("--why", help="With --trigger: what has happened.")] = "",
    start: Annotated[bool, typer.Option("--start", help="Start recorders of a gateway.")] = False,
    stop: Annotated[bool, typer.Option("--stop", help="Stop recorders of a gateway.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Record TOPICS into MCAP files until Ctrl-C, with definitions and QoS; or give orders to a gateway's recorders."""
    order = RecorderOrder(gateway, recorder, trigger, why, start, stop)
    if order.given:
        if topics or everything or regex:
            fail("a gateway records what its configuration says; leave the topics out", 2)
        carry_out(order, as_json=as_json)
        return
    choice = _choice(topics or [], everything=everything, regex=regex, exclude=exclude or [], hidden=include_hidden)
    conditions = _conditions(when or [], ring_s)
    if compression not in COMPRESSIONS:
        fail(f"{compression!r} is not a compression; use one of {', '.join(COMPRESSIONS)}", 2)
    base = output or stamped(Path("recording"))

    def files(path: Path) -> McapFiles:
        return McapFiles(path, compression=compression, split_bytes=int(split_mb * _MB), split_s=split_s)

    async def main() -> dict[str, Any]:
        async with AsyncExitStack() as stack:
            session = await stack.enter_async_context(open_session(graph, types))
            ended = _until_told(for_s)
            if not ring_s:
                writer = RecordingWriter(files(base), on_failure=ended.set)
                recorder = GraphRecorder(session.graph, session.registry, choice, writer.put, know=session.know).start()
                stack.push_async_callback(recorder.close)
                _say(as_json, f"recording to {base}; Ctrl-C ends it")
                await _wait(ended, writer, lambda: None if as_json else _progress(recorder, writer))
                await recorder.close()
                await writer.close()
                return _summary(writer, recorder)
            return await _clips(session, stack, choice, conditions, files, ended)

    async def _clips(
        session: Any,
        stack: AsyncExitStack,
        choice: TopicChoice,
        conditions: list[Condition],
        files: Callable[[Path], McapFiles],
        ended: asyncio.Event,
    ) -> dict[str, Any]:
        written: list[str] = []

        def done(clip: McapFiles) -> None:
            written.extend(map(str, clip.paths))
            if as_json:
                print_json({"clip": str(clip.paths[0]), "messages": clip.messages, "bytes": clip.bytes})
            else:
                answer(f"{clip.paths[0]}: {clip.messages} messages, {clip.bytes / _MB:.1f} MB")

        ring = Ring(ring_s, int(ring_mb * _MB))
        clips = ClipRecorder(ring, after_s, lambda: files(stamped(base)), on_clip=done)
        recorder = GraphRecorder(
            session.graph,
            session.registry,
            choice,
            clips.put,
            conditions=conditions,
            triggered=clips.trigger,
            know=session.know,
        ).start()
        stack.push_async_callback(recorder.close)
        with suppress(NotImplementedError, AttributeError):  # Windows has no such signal
            asyncio.get_running_loop().add_signal_handler(signal.SIGUSR1, clips.trigger, "SIGUSR1")
        told = " or ".join([*(condition.text for condition in conditions), "SIGUSR1"])
        _say(as_json, f"keeping the last {ring_s:g} s; a clip is written when {told}; Ctrl-C ends it")
        await ended.wait()
        await recorder.close()
        await clips.close()
        if clips.failures:
            fail(f"{clips.failures} clips could not be written: {clips.error}")
        return {"clips": written, "topics": sorted(recorder.topics), "not_recorded": recorder.refused}

    try:
        summary = run(main())
    except RecordingFailed as error:
        fail(f"{error}; what was written before stays")
    if as_json:
        print_json(summary)
    elif not ring_s:
        files_text = ", ".join(summary["files"]) or "no file, as nothing came"
        answer(f"{summary['messages']} messages, {summary['bytes'] / _MB:.1f} MB: {files_text}")
        for reason, count in summary["dropped"].items():
            complain(f"{count} messages were left out: {reason}")
    if not ring_s and summary["dropped"]:
        raise typer.Exit(1)


def _choice(names: list[str], *, everything: bool, regex: str, exclude: list[str], hidden: bool) -> TopicChoice:
    if not (names or everything or regex):
        fail("nothing to record; name topics, or give --all or --regex", 2)
    try:
        pattern = re.compile(regex) if regex else None
    except re.error as error:
        fail(f"{regex!r} is not a regular expression: {error}", 2)
    full = [name if set(name) & set("*?[") else full_name(name) for name in names]
    return TopicChoice(full, pattern, everything, exclude, hidden)


def _conditions(texts: list[str], ring_s: float) -> list[Condition]:
    if texts and not ring_s:
        fail("--when needs --ring: how many seconds before it are wanted?", 2)
    try:
        return [Condition(text) for text in texts]
    except ValueError as error:
        fail(str(error), 2)


def _until_told(for_s: float) -> asyncio.Event:
    """Return an event that is set by Ctrl-C, by SIGTERM, or after so many seconds."""
    ended, loop = asyncio.Event(), asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        with suppress(NotImplementedError, ValueError, RuntimeError):  # elsewhere Ctrl-C is an exception
            loop.add_signal_handler(number, ended.set)
    if for_s:
        loop.call_later(for_s, ended.set)
    return ended


async def _wait(ended: asyncio.Event, writer: RecordingWriter, tell: Callable[[], None]) -> None:
    """Wait until the recording is ended, or has failed; tell of it meanwhile."""
    while not ended.is_set():
        with suppress(TimeoutError):
            async with aio.timeout(_TOLD_S):
                await ended.wait()
        tell()
    if writer.failure is not None:
        raise writer.failure


def _progress(recorder: GraphRecorder, writer: RecordingWriter) -> None:
    if sys.stderr.isatty():
        lost = sum(writer.dropped.values())
        sys.stderr.write(
            f"\r{time.strftime('%H:%M:%S')}  {len(recorder.topics)} topics, {recorder.messages} messages, "
            f"{writer.files.bytes / _MB:.1f} MB{f', {lost} lost' if lost else ''}   "
        )
        sys.stderr.flush()


def _say(as_json: bool, text: str) -> None:
    if not as_json:
        complain(text)


def _summary(writer: RecordingWriter, recorder: GraphRecorder) -> dict[str, Any]:
    return {
        "files": [str(path) for path in writer.files.paths],
        "messages": writer.files.messages,
        "bytes": writer.files.bytes,
        "dropped": dict(writer.dropped),
        "not_recorded": recorder.refused,
    }
