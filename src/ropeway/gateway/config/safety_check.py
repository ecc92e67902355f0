"""Finds what makes no sense about guards of topics of commands."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

from ropeway.gateway.config.route_model import OPERATIONS
from ropeway.gateway.config.suggest import one_of

__all__ = ["safety_problems"]


def safety_problems(full: Mapping[str, Any], graphs: list[Any]) -> Iterable[tuple[str, str]]:
    """Yield the path and a sentence for each fault, of whatever is well-formed."""
    gateway = full.get("gateway")
    gateway = gateway if isinstance(gateway, Mapping) else {}
    seen: dict[tuple[str, str], str] = {}
    found = False
    for path, topic, graph in (*_listed(gateway, graphs), *_of_routes(full.get("remotes"), graphs)):
        found = True
        if topic is None:
            yield path, "only a topic that is subscribed has this key; elsewhere write gateway.safety at the robot"
            continue
        first = seen.setdefault((topic, graph), path)
        if first != path:
            yield path, f"the same topic as {first}; keep one"
        if graph not in graphs:
            yield path if path.endswith(".safety") else f"{path}.graph", one_of(graph, graphs)
    if found and gateway.get("workers", 0) != 0:
        yield "gateway.workers", "a lease of commands needs one process; write 0"


def _listed(gateway: Mapping[str, Any], graphs: list[Any]) -> Iterable[tuple[str, str | None, str]]:
    for number, item in enumerate(_list(gateway.get("safety"))):
        if isinstance(item, Mapping) and isinstance(item.get("topic"), str):
            yield f"gateway.safety[{number}]", _absolute(item["topic"]), str(item.get("graph") or graphs[0])


def _of_routes(remotes: object, graphs: list[Any]) -> Iterable[tuple[str, str | None, str]]:
    for index, remote in enumerate(_list(remotes)):
        if not isinstance(remote, Mapping):
            continue
        for operation in OPERATIONS:
            for number, item in enumerate(_list(remote.get(operation))):
                if isinstance(item, Mapping) and item.get("safety") is not None and isinstance(item.get("name"), str):
                    path = f"remotes[{index}].{operation}[{number}].safety"
                    namespace = str(remote.get("local_namespace") or "")
                    topic = _absolute(f"{namespace}/{item['name'].lstrip('/')}")
                    yield path, topic if operation == "subscribe" else None, str(remote.get("graph") or graphs[0])


def _absolute(name: str) -> str:
    return f"/{name.strip('/')}"


def _list(value: object) -> list[Any]:
    return list(value) if isinstance(value, list | tuple) else []
