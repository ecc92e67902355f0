"""``ropeway param dump``: all parameters of a node as a YAML file that ROS can load."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import typer
import yaml

from ropeway.cli.console import answer, print_json
from ropeway.cli.param.common import NodeArgument, TimeoutOption, ask, plain
from ropeway.cli.param.source import AtMaster, parameters_of, place_name
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph
from ropeway.graph.parameters import ParameterValue

__all__ = ["app", "nested"]

app = typer.Typer(add_completion=False)


def nested(values: Mapping[str, ParameterValue]) -> dict[str, Any]:
    """Return names with dots as dicts in dicts; if a name is also the beginning of others, these keep their dots."""
    out: dict[str, Any] = {}
    for name, value in sorted(values.items()):
        parts = name.split(".")
        place = out
        for depth, part in enumerate(parts[:-1]):
            inner = place.setdefault(part, {})
            if not isinstance(inner, dict):
                place[".".join(parts[depth:])] = plain(value)
                break
            place = inner
        else:
            place[parts[-1]] = plain(value)
    return out


@app.command("dump")
def dump(
    node: NodeArgument, graph: GraphOption = "", timeout: TimeoutOption = 5.0, as_json: JsonOption = False
) -> None:
    """Print all parameters of NODE as YAML, for ``--ros-args --params-file``, or ``rosparam load`` on ROS 1."""
    full = place_name(node)

    ros1 = False

    async def look(session: OpenGraph) -> dict[str, Any]:
        nonlocal ros1
        found = parameters_of(session, full, timeout)
        ros1 = isinstance(found, AtMaster)
        return await found.dump()

    values = {name: value for name, value in ask(graph, full, timeout, look).items() if value is not None}
    if as_json:
        print_json({"node": full, "parameters": {name: plain(value) for name, value in values.items()}})
    else:
        document = values if ros1 else {full: {"ros__parameters": nested(values)}}
        answer(yaml.safe_dump(document, sort_keys=True, default_flow_style=False, allow_unicode=True).rstrip("\n"))
