"""Parameters as rosapi has them: named ``/node:parameter``, their values as JSON texts."""

from __future__ import annotations

import asyncio
import json
import logging
import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Final

from ropeway import aio
from ropeway.errors import CallError, CallTimeout, RopewayError, ValueMismatch
from ropeway.graph.parameters import (
    ParameterType,
    ParameterValue,
    delete_parameters,
    describe_parameters,
    get_parameters,
    list_parameters,
    nodes_with_parameters,
    parse_value,
    set_parameters,
    type_of,
)
from ropeway.limits import PARAMETER_BRACKETS, PARAMETER_TEXT_CHARACTERS
from ropeway.listener.globs import Globs
from ropeway.networks.rosbridge.rosapi.snapshot import is_hidden_node
from ropeway.tasks import end
from ropeway.types.untrusted import json_value

if TYPE_CHECKING:
    from ropeway.graph.base import Graph
    from ropeway.types import TypeRegistry

__all__ = ["Params", "from_json", "to_json"]

log = logging.getLogger("ropeway.server")

_NODE_S: Final = 2.0  # roslibpy waits 3 s for the names of all nodes; one that does not answer must not spoil them
_AT_A_TIME: Final = 16
_NUMBERS: Final = (ParameterType.DOUBLE, ParameterType.DOUBLE_ARRAY)


class _Refused(Exception):
    """Raised when a parameter cannot be read or changed."""


class Params:
    """Asks the nodes of a graph. ``timeout_s`` bounds every call as a whole."""

    def __init__(self, graph: Graph, registry: TypeRegistry, globs: Globs, timeout_s: float) -> None:
        self._graph, self._registry, self._globs, self._timeout_s = graph, registry, globs, timeout_s
        self._turns = asyncio.Semaphore(_AT_A_TIME)

    async def get(self, name: str, default: str) -> dict[str, Any]:
        """Return the value of a parameter, or ``default`` with the reason."""
        try:
            async with aio.timeout(self._timeout_s):
                value = await self._get(*self._split(name, "get_parameters"))
        except (_Refused, RopewayError, TimeoutError) as error:
            return {"value": to_json(from_json(default)), "successful": False, "reason": _reason(error)}
        return {"value": to_json(value), "successful": True, "reason": ""}

    async def has(self, name: str) -> bool:
        """Return whether a node has the parameter and it is set."""
        try:
            async with aio.timeout(self._timeout_s):
                await self._get(*self._split(name, "get_parameters"))
        except (_Refused, RopewayError, TimeoutError):
            return False
        return True

    async def set(self, name: str, value: str) -> dict[str, Any]:
        """Set a parameter to a JSON text."""
        try:
            async with aio.timeout(self._timeout_s):
                node, parameter = self._split(name, "set_parameters")
                try:
                    given = json_value(value)
                except ValueError as error:
                    raise _Refused(
                        f"the value of a parameter is a JSON text, which {value!r:.100} is not: {error}"
                    ) from None
                wanted = await self._typed(node, parameter, given, value)
                refused = await set_parameters(
                    self._graph, self._registry, node, {parameter: wanted}, timeout_s=self._timeout_s
                )
        except (_Refused, RopewayError, TimeoutError) as error:
            return {"successful": False, "reason": _reason(error)}
        return _result(refused[parameter])

    async def delete(self, name: str) -> dict[str, Any]:
        """Delete a parameter; one that is not there needs no deleting."""
        try:
            async with aio.timeout(self._timeout_s):
                node, parameter = self._split(name, "set_parameters")
                known = await get_parameters(self._graph, self._registry, node, [parameter], timeout_s=self._timeout_s)
                if known[parameter] is None:
                    return _result(None)
                refused = await delete_parameters(
                    self._graph, self._registry, node, [parameter], timeout_s=self._timeout_s
                )
        except (_Refused, RopewayError, TimeoutError) as error:
            return {"successful": False, "reason": _reason(error)}
        return _result(refused[parameter])

    async def names(self) -> list[str]:
        """Return the parameters of all nodes that answer in time, as ``/node:parameter``."""
        nodes = [node for node in nodes_with_parameters(self._graph.services()) if not is_hidden_node(node)]
        tasks = {node: asyncio.create_task(self._list(node), name=f"parameters of {node}") for node in nodes}
        try:
            if tasks:
                await asyncio.wait(tasks.values(), timeout=self._timeout_s)
        finally:
            await end(*(task for task in tasks.values() if not task.done()))
        found = [
            f"{node}:{name}"
            for node, task in tasks.items()
            if not task.cancelled()
            for name in task.result()
            if self._shown(node, name)
        ]
        late = [node for node, task in tasks.items() if task.cancelled()]
        if late:
            log.debug("%d nodes did not tell their parameters in time: %s", len(late), ", ".join(late[:10]))
        return found

    async def _list(self, node: str) -> list[str]:
        async with self._turns:
            try:
                limit_s = min(_NODE_S, self._timeout_s)
                return await list_parameters(self._graph, self._registry, node, timeout_s=limit_s)
            except RopewayError as error:
                log.debug("the parameters of %s are not known: %s", node, error)
                return []

    async def _get(self, node: str, parameter: str) -> ParameterValue:
        found = await get_parameters(self._graph, self._registry, node, [parameter], timeout_s=self._timeout_s)
        value = found[parameter]
        if value is None:
            raise _Refused(f"Parameter {parameter} not found")
        return value

    def _split(self, name: str, service: str) -> tuple[str, str]:
        """Split ``/node:parameter`` into node and parameter; the node must be there and the parameter not hidden by a
        glob.
        """
        node, colon, parameter = name.partition(":")
        if not colon or not node.strip("/") or not parameter:
            raise _Refused(f"Malformed parameter name: {name}; expecting <node_name>:<param_name>")
        node = node if node.startswith("/") else f"/{node}"
        if not self._shown(node, parameter):
            raise _Refused(f"Parameter {parameter} does not match any of the glob strings")
        if not self._served(f"{node}/{service}"):
            raise _Refused(f"Service {node}/{service} is not available")
        return node, parameter

    def _served(self, service: str) -> bool:
        known = self._graph.services().get(service)
        return known is not None and bool(known.servers or not known.clients)

    def _shown(self, node: str, parameter: str) -> bool:
        patterns = self._globs.params
        return Globs.allows(parameter, patterns) or Globs.allows(f"{node}:{parameter}", patterns)

    async def _typed(self, node: str, parameter: str, given: Any, text: str) -> ParameterValue:
        """Return the value in the type that the node gives the parameter: JavaScript writes 5.0 as 5.

        Where that is not known, the type is that of the value, and a text is read as ``ros2 param set`` does.
        """
        kind = ParameterType.NOT_SET
        if not isinstance(given, bool) and self._served(f"{node}/describe_parameters"):
            try:
                described = await describe_parameters(
                    self._graph, self._registry, node, [parameter], timeout_s=self._timeout_s
                )
                found = described[parameter]
                kind = found.type if found is not None else kind
            except CallTimeout:
                raise
            except RopewayError as error:
                log.debug("the type of %s:%s is not known: %s", node, parameter, error)
        return _fitted(given, text, kind)


def _fitted(given: Any, text: str, kind: ParameterType) -> ParameterValue:
    if isinstance(given, str):
        return given if kind is ParameterType.STRING else _read(given)
    if kind is ParameterType.STRING:
        return text
    if _is_number(given):
        return float(given) if kind is ParameterType.DOUBLE else given
    if isinstance(given, list) and given and all(map(_is_number, given)):
        if kind is ParameterType.BYTE_ARRAY and all(isinstance(n, int) and 0 <= n < 256 for n in given):
            return bytes(given)
        mixed = any(isinstance(n, float) for n in given)
        return [float(n) for n in given] if mixed or kind in _NUMBERS else given
    try:
        return given if type_of(given) is not ParameterType.NOT_SET else text
    except ValueMismatch:
        return text


def _read(text: str) -> ParameterValue:
    """Return what a text stands for, as ``ros2 param set`` reads it; a long or a nested one stands for itself."""
    if len(text) > PARAMETER_TEXT_CHARACTERS or text.count("[") + text.count("{") > PARAMETER_BRACKETS:
        return text
    return parse_value(text)


def _is_number(value: object) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def _result(refusal: str | None) -> dict[str, Any]:
    return {"successful": refusal is None, "reason": refusal or ""}


def _reason(error: BaseException) -> str:
    if isinstance(error, (TimeoutError, CallTimeout)):
        return "Timeout occurred"
    return str(error) if str(error) or not isinstance(error, CallError) else f"{error.name} failed"


def from_json(text: str) -> Any:
    """Parse a JSON text; anything else gives an empty text."""
    try:
        return json_value(text) if text else ""
    except ValueError:
        return ""


def to_json(value: Any) -> str:
    """Write a JSON text that every client parses: bytes as numbers, NaN and infinity as ``null``."""
    if isinstance(value, bytes):
        value = list(value)
    try:
        return json.dumps(value, allow_nan=False)
    except ValueError:
        return json.dumps(_finite(value))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Sequence) and not isinstance(value, str):
        return [_finite(item) for item in value]
    if isinstance(value, dict):
        return {key: _finite(item) for key, item in value.items()}
    return value
