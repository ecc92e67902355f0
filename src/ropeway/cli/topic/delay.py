"""``ropeway topic delay``: how old messages are when they arrive."""

from __future__ import annotations

import typer

from ropeway.cli.console import fail
from ropeway.cli.loop import run
from ropeway.cli.session import (
    GraphOption,
    JsonOption,
    OpenGraph,
    QosReliability,
    SpinOption,
    TypesOption,
    qos_of,
    topic_name,
)
from ropeway.cli.topic.watch import TopicArgument, TypeArgument, WindowOption, meter_main
from ropeway.cli.topic.window import Delay

__all__ = ["app", "gauge"]

app = typer.Typer(add_completion=False)


def gauge(session: OpenGraph, type: str, window: int) -> Delay:
    """Make the meter for a type, or exit with a sentence if its messages have no stamp."""
    codec = session.registry.codec(type)
    if codec.header_stamp_ns(codec.encode({})) is None:
        fail(f"{type} does not begin with a header, so the delay cannot be measured; `ropeway topic hz` tells the rate")
    return Delay(window, codec.header_stamp_ns)


@app.command("delay")
def delay(
    topic: TopicArgument,
    type: TypeArgument = "",
    graph: GraphOption = "",
    window: WindowOption = 10_000,
    qos_reliability: QosReliability = "",
    types: TypesOption = None,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Print the delay of TOPIC, from the stamps in its headers, every second."""
    run(
        meter_main(
            lambda session, type: gauge(session, type, window),
            topic_name(topic),
            type,
            graph=graph,
            qos=qos_of("", None, "", qos_reliability, ""),
            types=types,
            spin_time_s=spin_time,
            as_json=as_json,
            silence="no new messages",
        )
    )
