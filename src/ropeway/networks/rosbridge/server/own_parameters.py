"""The parameters of our own node, served as every node of ROS 2 serves its own: ``ros2 param get`` finds them.

Tools and launch tests of rosbridge look them up; ``actual_port`` is how they learn which free port was taken.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from ropeway.graph.parameters import ParameterValue, to_message, type_of
from ropeway.limits import SHOWN_TEXT_CHARACTERS

if TYPE_CHECKING:
    from ropeway.graph.base import Graph
    from ropeway.graph.calls import Request, Service
    from ropeway.types import TypeRegistry

__all__ = ["OwnParameter", "OwnParameters"]

_Answer = Callable[[Mapping[str, Any]], dict[str, Any]]


@dataclass(frozen=True, slots=True)
class OwnParameter:
    """A parameter of our own node. Its value stands until the program ends; ``change`` says how to have another."""

    name: str
    value: ParameterValue
    description: str = ""
    change: str = "start the program anew with another value"


class OwnParameters:
    """Serves ``parameters`` as those of ``node`` on ``graph``, a view of it that nobody else uses."""

    def __init__(self, graph: Graph, registry: TypeRegistry, node: str, parameters: Sequence[OwnParameter]) -> None:
        self._graph, self._registry, self._node = graph, registry, node
        self._parameters: Final = {parameter.name: parameter for parameter in parameters}
        self._services: list[Service] = []

    async def open(self) -> None:
        """Offer the services. Raises what ``Graph.create_service`` raises; none is offered then."""
        answers: dict[str, _Answer] = {
            "ListParameters": self._list,
            "GetParameters": lambda asked: {"values": self._each(asked, lambda known: to_message(known.value))},
            "GetParameterTypes": lambda asked: {"types": self._each(asked, lambda known: int(type_of(known.value)))},
            "DescribeParameters": lambda asked: {"descriptors": self._each(asked, _descriptor)},
            "SetParameters": lambda asked: {"results": [self._refusal(given["name"]) for given in asked["parameters"]]},
            "SetParametersAtomically": self._set_all,
        }
        try:
            for type, answer in answers.items():
                await self._offer(type, answer)
        except BaseException:
            await self.close()
            raise

    async def close(self) -> None:
        """Withdraw the parameter services."""
        while self._services:
            await self._services.pop().close()

    async def _offer(self, type: str, answer: _Answer) -> None:
        full = f"rcl_interfaces/srv/{type}"
        asked, told = self._registry.codec(f"{full}_Request"), self._registry.codec(f"{full}_Response")
        words = "".join(f"_{c.lower()}" if c.isupper() else c for c in type).removeprefix("_")

        async def handle(request: Request) -> bytes:
            return told.encode(answer(asked.decode(request.payload)))

        self._services.append(await self._graph.create_service(f"{self._node}/{words}", full, handle))

    def _list(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        prefixes, depth = asked["prefixes"], asked["depth"]
        names = [name for name in self._parameters if _listed(name, prefixes, depth)]
        above = {name.rpartition(".")[0] for name in names} - {""}
        return {"result": {"names": names, "prefixes": sorted(above)}}

    def _each(self, asked: Mapping[str, Any], make: Callable[[OwnParameter], Any]) -> list[Any]:
        """Return what ``make`` gives for each requested name; nothing if one is unknown, like nodes of ROS 2."""
        found = [self._parameters.get(name) for name in asked["names"]]
        return [] if None in found else [make(known) for known in found if known is not None]

    def _set_all(self, asked: Mapping[str, Any]) -> dict[str, Any]:
        refusals = [self._refusal(given["name"]) for given in asked["parameters"]]
        return {"result": refusals[0] if refusals else {"successful": True, "reason": ""}}

    def _refusal(self, name: str) -> dict[str, Any]:
        known = self._parameters.get(name)
        if known is None:
            reason = f"{self._node} has no parameter {name[:SHOWN_TEXT_CHARACTERS]}"
        else:
            reason = f"{name} is read-only while {self._node} runs: {known.change}"
        return {"successful": False, "reason": reason}


def _descriptor(known: OwnParameter) -> dict[str, Any]:
    return {
        "name": known.name,
        "type": int(type_of(known.value)),
        "description": known.description,
        "additional_constraints": known.change,
        "read_only": True,
    }


def _listed(name: str, prefixes: Sequence[str], depth: int) -> bool:
    """Return whether a name is at or below one of ``prefixes`` (any, without), at most ``depth`` levels down
    (0: any).
    """
    for prefix in prefixes or [""]:
        if name == prefix or not prefix or name.startswith(f"{prefix}."):
            below = name[len(prefix) :].strip(".")
            if not depth or below.count(".") < depth:
                return True
    return False
