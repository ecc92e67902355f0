"""Reads one topic until the end: what ``echo``, ``hz``, ``bw`` and ``delay`` share."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import answer, complain, fail, print_json
from ropeway.cli.patience import patiently, why_silent
from ropeway.cli.refusal import unless_refused
from ropeway.cli.session import OpenGraph, find_topic, open_session
from ropeway.cli.topic.window import TopicMeter
from ropeway.graph.base import Sample
from ropeway.qos import QoS

__all__ = ["TopicArgument", "TypeArgument", "WindowOption", "meter", "meter_main", "resolve_type"]

TopicArgument = Annotated[str, typer.Argument(help="The topic, such as /chatter.", show_default=False)]
TypeArgument = Annotated[str, typer.Argument(help="Its type, if it is not discovered.", show_default=False)]
WindowOption = Annotated[int, typer.Option("--window", "-w", min=1, help="How many of the newest messages count.")]


async def resolve_type(session: OpenGraph, topic: str, given: str, spin_time_s: float) -> str:
    """Return the type as given or as discovered, or exit with a sentence if neither gives it."""
    if given:
        type = session.registry.canonical(given)
        await session.know(type)
        return type
    found = await find_topic(session.graph, topic, spin_time_s)
    if found is None:
        complain(f"WARNING: topic [{topic}] does not appear to be published yet")
        fail(f"Could not determine the type for {topic}; name it after the topic, or wait longer with --spin-time")
    if len(found.types) > 1:
        fail(f"{topic} has several types ({', '.join(found.types)}); name one after the topic")
    if not found.type:
        fail(f"{session.graph.name} does not tell the type of {topic}; name it after the topic")
    await session.know(found.type)
    return found.type


async def meter(
    session: OpenGraph,
    topic: str,
    type: str,
    qos: QoS | None,
    gauge: TopicMeter,
    *,
    as_json: bool = False,
    silence: str = "",
    period_s: float = 1.0,
) -> None:
    """Print what ``gauge`` reads every ``period_s``, without drift, until cancelled.

    Where it has nothing new to tell, ``silence`` is printed.
    """
    async with patiently(lambda: why_silent(session.graph, topic, type, qos)) as patience:

        def received(batch: Sequence[Sample]) -> None:
            patience.over()
            for sample in batch:
                gauge.add(sample)

        subscription = await session.graph.create_subscription(topic, type, qos, received)
        try:
            with unless_refused(session.graph, subscription):
                await _read_out(gauge, topic, as_json=as_json, silence=silence, period_s=period_s)
        finally:
            await subscription.close()


async def _read_out(gauge: TopicMeter, topic: str, *, as_json: bool, silence: str, period_s: float) -> None:
    loop = asyncio.get_running_loop()
    due = loop.time()
    started = False
    while True:
        due += period_s
        await asyncio.sleep(max(due - loop.time(), 0))
        reading = gauge.read()
        started = started or reading is not None
        if reading is None:
            if silence and started and not as_json:
                answer(silence)
        elif as_json:
            print_json({"topic": topic, **reading.json})
        else:
            answer(reading.text)


async def meter_main(
    make: Callable[[OpenGraph, str], TopicMeter],
    topic: str,
    given_type: str,
    *,
    graph: str,
    qos: QoS | None,
    types: list[Path] | None,
    spin_time_s: float,
    as_json: bool,
    silence: str = "",
) -> None:
    """Open the graph, find the type, make the meter for it and run it."""
    async with open_session(graph, types) as session:
        type = await resolve_type(session, topic, given_type, spin_time_s)
        gauge = make(session, type)
        if not as_json:
            complain(f"Subscribed to [{topic}]")
        await meter(session, topic, type, qos, gauge, as_json=as_json, silence=silence)
