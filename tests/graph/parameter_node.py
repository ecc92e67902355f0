"""A node with the parameter services of ROS 2, on any graph."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ropeway.graph.base import Graph
from ropeway.graph.calls import Request
from ropeway.graph.parameters import ParameterValue, from_message, to_message, type_of
from ropeway.types import TypeRegistry

REGISTRY = TypeRegistry()


class ParameterNode:
    """Serves the parameters in ``values``; those in ``read_only`` cannot be set, unknown ones are refused."""

    def __init__(self, values: dict[str, ParameterValue], *, read_only: tuple[str, ...] = ()) -> None:
        self.values = values
        self.read_only = read_only
        self.calls: list[str] = []

    async def serve(self, graph: Graph, node: str) -> ParameterNode:
        """Offer the services of ``node`` on a graph."""
        for name, type, answer in (
            ("list_parameters", "ListParameters", self._list),
            ("get_parameters", "GetParameters", self._get),
            ("describe_parameters", "DescribeParameters", self._describe),
            ("set_parameters", "SetParameters", self._set),
        ):
            await self._offer(graph, f"{node}/{name}", f"rcl_interfaces/srv/{type}", answer)
        return self

    async def _offer(self, graph: Graph, name: str, type: str, answer: Callable[[dict[str, Any]], Any]) -> None:
        async def handle(request: Request) -> bytes:
            self.calls.append(name)
            asked = REGISTRY.codec(f"{type}_Request").decode(request.payload)
            return REGISTRY.codec(f"{type}_Response").encode(answer(asked))

        await graph.create_service(name, type, handle)

    def _list(self, asked: dict[str, Any]) -> dict[str, Any]:
        prefixes = tuple(f"{prefix}." for prefix in asked["prefixes"])
        names = [name for name in self.values if not prefixes or name.startswith(prefixes)]
        return {"result": {"names": names, "prefixes": []}}

    def _get(self, asked: dict[str, Any]) -> dict[str, Any]:
        if not all(name in self.values for name in asked["names"]):
            return {"values": []}
        return {"values": [to_message(self.values[name]) for name in asked["names"]]}

    def _describe(self, asked: dict[str, Any]) -> dict[str, Any]:
        if not all(name in self.values for name in asked["names"]):
            return {"descriptors": []}
        return {
            "descriptors": [
                {
                    "name": name,
                    "type": int(type_of(self.values[name])),
                    "description": f"what {name} is for",
                    "read_only": name in self.read_only,
                    "floating_point_range": [{"from_value": 0.0, "to_value": 9.0, "step": 0.5}]
                    if isinstance(self.values[name], float)
                    else [],
                }
                for name in asked["names"]
            ]
        }

    def _set(self, asked: dict[str, Any]) -> dict[str, Any]:
        results = []
        for parameter in asked["parameters"]:
            name, value = parameter["name"], from_message(parameter["value"])
            if name not in self.values:
                results.append({"successful": False, "reason": f"{name} was not declared"})
            elif name in self.read_only:
                results.append({"successful": False, "reason": f"{name} is read-only"})
            else:
                results.append({"successful": True, "reason": ""})
                if value is None:
                    del self.values[name]
                else:
                    self.values[name] = value
        return {"results": results}
