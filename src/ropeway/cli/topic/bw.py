"""``ropeway topic bw``: how many bytes come per second."""

from __future__ import annotations

import time

import typer

from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, QosReliability, SpinOption, TypesOption, qos_of, topic_name
from ropeway.cli.topic.watch import TopicArgument, TypeArgument, WindowOption, meter_main
from ropeway.cli.topic.window import Bandwidth

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("bw")
def bw(
    topic: TopicArgument,
    type: TypeArgument = "",
    graph: GraphOption = "",
    window: WindowOption = 100,
    qos_reliability: QosReliability = "",
    types: TypesOption = None,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Print the bandwidth of TOPIC every second."""
    run(
        meter_main(
            lambda session, type: Bandwidth(window, time.time_ns),
            topic_name(topic),
            type,
            graph=graph,
            qos=qos_of("", None, "", qos_reliability, ""),
            types=types,
            spin_time_s=spin_time,
            as_json=as_json,
        )
    )
