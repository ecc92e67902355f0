"""``ropeway topic echo``: the messages themselves."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Annotated, Final

import orjson
import typer

from ropeway import aio
from ropeway.cli.console import answer, complain, fail
from ropeway.cli.loop import run
from ropeway.cli.patience import patiently, why_silent
from ropeway.cli.refusal import unless_refused
from ropeway.cli.session import (
    GraphOption,
    JsonOption,
    OpenGraph,
    QosDepth,
    QosDurability,
    QosHistory,
    QosProfile,
    QosReliability,
    SpinOption,
    TypesOption,
    open_session,
    qos_of,
    topic_name,
)
from ropeway.cli.topic.render import Style, as_csv, as_yaml, pick, shown
from ropeway.cli.topic.watch import TopicArgument, TypeArgument, resolve_type
from ropeway.errors import DecodeError
from ropeway.graph.base import Sample
from ropeway.qos import QoS
from ropeway.types import TypeRegistry

__all__ = ["app", "echo", "formatter"]

app = typer.Typer(add_completion=False)

Formatter = Callable[[Sample], str]
_BACKLOG: Final = 1000  # messages that may wait to be printed; a terminal slower than that loses the oldest


def formatter(registry: TypeRegistry, type: str, *, style: Style, form: str = "yaml", field: str = "") -> Formatter:
    """Make the function that formats a message; ``form`` is yaml, csv, raw or json.

    It raises ``DecodeError`` for a message that is not of the type, ``LookupError`` where there is no such field.
    """
    if form == "raw":
        return lambda sample: f"{bytes(sample.payload)!r}\n---"
    codec = registry.codec(type)
    whole = Style(truncate=None)

    def as_json(sample: Sample) -> str:
        if field:
            message = orjson.loads(orjson.dumps(_field_json(sample)))
        else:
            message = orjson.Fragment(codec.json(sample.payload))
        return orjson.dumps({"type": codec.type, "received_ns": sample.stamp_ns, "msg": message}).decode()

    def _field_json(sample: Sample) -> object:
        return shown(registry, pick(registry, codec.type, codec.decode(sample.payload), field), whole)

    def as_text(sample: Sample) -> str:
        part = pick(registry, codec.type, codec.decode(sample.payload), field)
        value = shown(registry, part, style)
        if form == "csv":
            return as_csv(value)
        if isinstance(value, dict):
            return f"{as_yaml(value, style)}---"
        if isinstance(value, list):
            return f"{as_yaml(value, Style(flow=True))}---"
        return f"{value}\n---"

    return as_json if form == "json" else as_text


async def echo(
    session: OpenGraph,
    topic: str,
    type: str,
    qos: QoS | None,
    form: Formatter,
    *,
    count: int | None = None,
    emit: Callable[[str], None] = answer,
) -> int:
    """Print messages until ``count`` of them were printed, for ever without; returns how many were."""
    waiting: asyncio.Queue[Sample] = asyncio.Queue(_BACKLOG)
    lost = 0

    def received(batch: Sequence[Sample]) -> None:
        nonlocal lost
        for sample in batch:
            if waiting.full():
                waiting.get_nowait()
                lost += 1
            waiting.put_nowait(sample)

    printed = 0
    subscription = await session.graph.create_subscription(topic, type, qos, received)
    try:
        with unless_refused(session.graph, subscription):
            async with patiently(lambda: why_silent(session.graph, topic, type, qos)) as patience:
                while count is None or printed < count:
                    sample = await waiting.get()
                    patience.over()
                    if lost:
                        complain(f"{lost} messages were lost, because they come faster than they can be printed")
                        lost = 0
                    printed += _emit(form, sample, emit)
    finally:
        await subscription.close()
    return printed


def _emit(form: Formatter, sample: Sample, emit: Callable[[str], None]) -> bool:
    """Print a message; return whether it could be printed."""
    try:
        emit(form(sample))
    except DecodeError as error:
        complain(f"A message was not printed: {error}")
        return False
    except LookupError as error:
        fail(str(error.args[0]))
    return True


@app.command("echo")
def echo_command(
    topic: TopicArgument,
    type: TypeArgument = "",
    graph: GraphOption = "",
    once: Annotated[bool, typer.Option("--once", help="Print the first message and end.")] = False,
    timeout: Annotated[float, typer.Option("--timeout", min=0.0, help="End after this many seconds; 0: never.")] = 0.0,
    field: Annotated[str, typer.Option("--field", help="Only a part, such as pose.position or ranges[0].")] = "",
    csv: Annotated[bool, typer.Option("--csv", help="All values on one line, separated by commas.")] = False,
    raw: Annotated[bool, typer.Option("--raw", help="The CDR bytes.")] = False,
    full_length: Annotated[bool, typer.Option("--full-length", "-f", help="Do not cut arrays and strings.")] = False,
    truncate_length: Annotated[
        int, typer.Option("--truncate-length", "-l", min=0, help="The length at which arrays and strings are cut.")
    ] = 128,
    no_arr: Annotated[bool, typer.Option("--no-arr", help="Only say how long arrays are.")] = False,
    no_str: Annotated[bool, typer.Option("--no-str", help="Only say how long strings are.")] = False,
    flow_style: Annotated[bool, typer.Option("--flow-style", help="YAML on one line.")] = False,
    qos_profile: QosProfile = "",
    qos_depth: QosDepth = None,
    qos_history: QosHistory = "",
    qos_reliability: QosReliability = "",
    qos_durability: QosDurability = "",
    types: TypesOption = None,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Print the messages of TOPIC. Without --qos options, what the publishers offer is asked for."""
    name = topic_name(topic)
    qos = qos_of(qos_profile, qos_depth, qos_history, qos_reliability, qos_durability)
    forms = [form for form, asked in (("csv", csv), ("raw", raw), ("json", as_json)) if asked]
    if len(forms) > 1:
        fail(f"--{forms[0]} and --{forms[1]} exclude each other; give one", 2)
    style = Style(None if full_length else truncate_length, no_arr, no_str, flow_style)

    async def main() -> int:
        async with open_session(graph, types) as session:
            found = await resolve_type(session, name, type, spin_time)
            form = formatter(session.registry, found, style=style, form=(forms or ["yaml"])[0], field=field)
            try:
                async with aio.timeout(timeout or None):
                    return await echo(session, name, found, qos, form, count=1 if once else None)
            except TimeoutError:
                return 0

    if run(main()) == 0 and once:
        fail(f"no message on {name} within {timeout:g} s")
