"""Parameters of nodes, asked for and set through the parameter services that every ROS 2 node has.

A value is a ``bool``, ``int``, ``float``, ``str``, ``bytes``, a list of one of the first four, or ``None`` for a
parameter that is not set. Every function asks one node, within ``timeout_s``, and raises ``CallError`` (``NotServed``
for a node without parameter services, ``CallTimeout``, ...), ``InvalidName`` for a node name that is none,
``UnknownType`` where the registry is of a distribution without ``rcl_interfaces``, and ``DecodeError`` for an answer
that is unreadable.
"""

from __future__ import annotations

import asyncio
import enum
from collections.abc import Iterable, Mapping, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass
from typing import Any, Final

from ropeway.errors import ValueMismatch
from ropeway.graph.base import Graph, resolve_name
from ropeway.graph.calls import DEFAULT_TIMEOUT_S, Request, ServiceInfo
from ropeway.types import TypeRegistry

__all__ = [
    "ParameterDescription",
    "ParameterType",
    "ParameterValue",
    "delete_parameters",
    "describe_parameters",
    "from_message",
    "get_parameters",
    "list_parameters",
    "nodes_with_parameters",
    "parse_value",
    "set_parameters",
    "to_message",
    "type_of",
]

ParameterValue = bool | int | float | str | bytes | list[bool] | list[int] | list[float] | list[str] | None


class ParameterType(enum.IntEnum):
    """rcl_interfaces/msg/ParameterType."""

    NOT_SET = 0
    BOOL = 1
    INTEGER = 2
    DOUBLE = 3
    STRING = 4
    BYTE_ARRAY = 5
    BOOL_ARRAY = 6
    INTEGER_ARRAY = 7
    DOUBLE_ARRAY = 8
    STRING_ARRAY = 9

    @property
    def label(self) -> str:
        """The name as ``ros2 param`` writes it: ``integer array``."""
        return self.name.lower().replace("_", " ").replace("bool", "boolean")


_FIELDS: Final = {
    ParameterType.BOOL: "bool_value",
    ParameterType.INTEGER: "integer_value",
    ParameterType.DOUBLE: "double_value",
    ParameterType.STRING: "string_value",
    ParameterType.BYTE_ARRAY: "byte_array_value",
    ParameterType.BOOL_ARRAY: "bool_array_value",
    ParameterType.INTEGER_ARRAY: "integer_array_value",
    ParameterType.DOUBLE_ARRAY: "double_array_value",
    ParameterType.STRING_ARRAY: "string_array_value",
}
_SCALARS: Final = (
    (bool, ParameterType.BOOL, ParameterType.BOOL_ARRAY),
    (int, ParameterType.INTEGER, ParameterType.INTEGER_ARRAY),
    (float, ParameterType.DOUBLE, ParameterType.DOUBLE_ARRAY),
    (str, ParameterType.STRING, ParameterType.STRING_ARRAY),
)
_LIST: Final = "list_parameters"
_LIST_TYPE: Final = "rcl_interfaces/srv/ListParameters"


@dataclass(frozen=True, slots=True)
class ParameterDescription:
    """A node's description of a parameter; ``range`` is (from, to, step) if the node limits a number."""

    name: str
    type: ParameterType
    description: str = ""
    constraints: str = ""
    read_only: bool = False
    dynamic_typing: bool = False
    range: tuple[float, float, float] | None = None


def type_of(value: ParameterValue) -> ParameterType:
    """Return the type that a node gives this value; an empty list counts as one of bools, as in ROS 2.

    Raises ``ValueMismatch`` for what is no value of a parameter, as a list of unlike items.
    """
    if value is None:
        return ParameterType.NOT_SET
    if isinstance(value, bytes):
        return ParameterType.BYTE_ARRAY
    for kind, scalar, array in _SCALARS:
        if type(value) is kind:
            return scalar
        if isinstance(value, list) and all(type(item) is kind for item in value):
            return array
    raise ValueMismatch(
        "rcl_interfaces/msg/ParameterValue", "", f"{value!r} is not a parameter value: lists need items of one type"
    )


def to_message(value: ParameterValue) -> dict[str, Any]:
    """Return the ``ParameterValue`` message of a value. Raises ``ValueMismatch``."""
    kind = type_of(value)
    message: dict[str, Any] = {"type": int(kind)}
    if kind is not ParameterType.NOT_SET:
        message[_FIELDS[kind]] = value
    return message


def from_message(message: Mapping[str, Any]) -> ParameterValue:
    """Return the value in a ``ParameterValue`` message; a type that ROS does not define gives ``None``."""
    field = _FIELDS.get(message["type"])
    if field is None:
        return None
    value = message[field]
    return value.tolist() if hasattr(value, "tolist") else value  # type: ignore[no-any-return]


def parse_value(text: str) -> ParameterValue:
    """Return the value that a text stands for, by the rules of ``ros2 param set``.

    The text is read as YAML; what is neither a bool, a number, a text nor a list of one of these stays a text.
    """
    import yaml  # a megabyte that a gateway does not need

    try:
        value = yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError):
        return text
    if isinstance(value, (bool, int, float, list)):
        try:
            type_of(value)
        except ValueMismatch:
            return text
        return value
    return value if isinstance(value, str) else text


def nodes_with_parameters(services: Mapping[str, ServiceInfo]) -> list[str]:
    """Return the names of the nodes that have parameter services, sorted, given what ``Graph.services`` lists."""
    found = [name for name, info in services.items() if info.servers and (_LIST_TYPE in info.types or not info.types)]
    return sorted(name.removesuffix(f"/{_LIST}") for name in found if name.endswith(f"/{_LIST}"))


async def list_parameters(
    graph: Graph,
    registry: TypeRegistry,
    node: str,
    *,
    prefixes: Sequence[str] = (),
    depth: int = 0,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> list[str]:
    """Return the names of a node's parameters, sorted.

    ``prefixes`` selects those below a name (``qos_overrides``), ``depth`` how many levels of dots, 0 meaning all.
    """
    async with _Node(graph, registry, node, timeout_s) as asked:
        answer = await asked.call(_LIST, "ListParameters", {"prefixes": list(prefixes), "depth": depth})
    return sorted(answer["result"]["names"])


async def get_parameters(
    graph: Graph,
    registry: TypeRegistry,
    node: str,
    names: Iterable[str],
    *,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> dict[str, ParameterValue]:
    """Return the values of parameters by name, ``None`` for one that the node does not have."""
    wanted = list(names)
    async with _Node(graph, registry, node, timeout_s) as asked:
        values = await asked.each("get_parameters", "GetParameters", "values", wanted)
    return {name: None if value is None else from_message(value) for name, value in zip(wanted, values, strict=True)}


async def describe_parameters(
    graph: Graph,
    registry: TypeRegistry,
    node: str,
    names: Iterable[str],
    *,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> dict[str, ParameterDescription | None]:
    """Return the node's descriptions of parameters by name, ``None`` for one that it does not have."""
    wanted = list(names)
    async with _Node(graph, registry, node, timeout_s) as asked:
        found = await asked.each("describe_parameters", "DescribeParameters", "descriptors", wanted)
    return {name: None if one is None else _description(name, one) for name, one in zip(wanted, found, strict=True)}


async def set_parameters(
    graph: Graph,
    registry: TypeRegistry,
    node: str,
    values: Mapping[str, ParameterValue],
    *,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> dict[str, str | None]:
    """Set parameters, each on its own: ``None`` for one that was set, else why the node refuses.

    A refusal without a reason gives ``""``. Raises ``ValueMismatch`` for a value that no parameter can have.
    """
    wanted = [{"name": name, "value": to_message(value)} for name, value in values.items()]
    async with _Node(graph, registry, node, timeout_s) as asked:
        answer = await asked.call("set_parameters", "SetParameters", {"parameters": wanted})
    results = answer["results"]
    refused: dict[str, str | None] = dict.fromkeys(values, "the node did not say whether it was set")
    for name, result in zip(values, results, strict=False):
        refused[name] = None if result["successful"] else result["reason"]
    return refused


async def delete_parameters(
    graph: Graph,
    registry: TypeRegistry,
    node: str,
    names: Iterable[str],
    *,
    timeout_s: float = DEFAULT_TIMEOUT_S,
) -> dict[str, str | None]:
    """Delete parameters; the answer is as of ``set_parameters``."""
    return await set_parameters(graph, registry, node, dict.fromkeys(names), timeout_s=timeout_s)


def _description(name: str, message: Mapping[str, Any]) -> ParameterDescription:
    limits = [*message["floating_point_range"], *message["integer_range"]]
    try:
        kind = ParameterType(message["type"])
    except ValueError:
        kind = ParameterType.NOT_SET
    return ParameterDescription(
        message["name"] or name,
        kind,
        message["description"],
        message["additional_constraints"],
        message["read_only"],
        bool(message.get("dynamic_typing")),  # Foxy has no such field
        (limits[0]["from_value"], limits[0]["to_value"], limits[0]["step"]) if limits else None,
    )


class _Node:
    """A node whose parameter services are called, all within one time."""

    def __init__(self, graph: Graph, registry: TypeRegistry, node: str, timeout_s: float) -> None:
        self._graph, self._registry, self._node = graph, registry, resolve_name(node)
        self._timeout_s = timeout_s
        self._clients = AsyncExitStack()
        self._deadline = 0.0

    async def __aenter__(self) -> _Node:
        self._deadline = asyncio.get_running_loop().time() + self._timeout_s
        return self

    async def __aexit__(self, *error: object) -> None:
        await self._clients.aclose()

    async def call(self, service: str, type: str, request: Mapping[str, Any]) -> dict[str, Any]:
        """Call one of the node's parameter services and return its answer."""
        return (await self._calls(service, type, [request]))[0]

    async def each(self, service: str, type: str, field: str, names: list[str]) -> list[Any]:
        """Return the node's answer for each name, ``None`` for one that it does not know.

        A node that does not know one of the names answers with an empty list, so each is then asked for alone.
        """
        if not names:
            return []
        answer = await self.call(service, type, {"names": names})
        if len(answer[field]) == len(names):
            return list(answer[field])
        if len(names) == 1:
            return [None]
        answers = await self._calls(service, type, [{"names": [name]} for name in names])
        return [found[field][0] if len(found[field]) == 1 else None for found in answers]

    async def _calls(self, service: str, type: str, requests: Sequence[Mapping[str, Any]]) -> list[dict[str, Any]]:
        full = f"rcl_interfaces/srv/{type}"
        ask, read = self._registry.codec(f"{full}_Request"), self._registry.codec(f"{full}_Response")
        client = await self._graph.create_client(f"{self._node}/{service}", full)
        self._clients.push_async_callback(client.close)
        loop = asyncio.get_running_loop()
        await client.wait_available(max(self._deadline - loop.time(), 0.0))  # a node may not be discovered yet
        answers = []
        for request in requests:
            left_s = max(self._deadline - loop.time(), 0.001)
            answers.append(read.decode(await client.call(Request(ask.encode(request), timeout_s=left_s), left_s)))
        return answers
