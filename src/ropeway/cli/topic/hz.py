"""``ropeway topic hz``: how often messages come."""

from __future__ import annotations

import typer

from ropeway.cli.loop import run
from ropeway.cli.session import GraphOption, JsonOption, QosReliability, SpinOption, TypesOption, qos_of, topic_name
from ropeway.cli.topic.watch import TopicArgument, TypeArgument, WindowOption, meter_main
from ropeway.cli.topic.window import Rate

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("hz")
def hz(
    topic: TopicArgument,
    type: TypeArgument = "",
    graph: GraphOption = "",
    window: WindowOption = 10_000,
    qos_reliability: QosReliability = "",
    types: TypesOption = None,
    spin_time: SpinOption = 2.0,
    as_json: JsonOption = False,
) -> None:
    """Print the average rate of TOPIC every second."""
    run(
        meter_main(
            lambda session, type: Rate(window),
            topic_name(topic),
            type,
            graph=graph,
            qos=qos_of("", None, "", qos_reliability, ""),
            types=types,
            spin_time_s=spin_time,
            as_json=as_json,
        )
    )
