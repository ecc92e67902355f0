"""Finds the parameters of a verb: at a ROS 2 node, or at the ROS 1 master, which keeps those of all nodes."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Protocol

from ropeway.cli.console import fail
from ropeway.cli.session import OpenGraph, full_name
from ropeway.errors import ValueMismatch
from ropeway.graph import parameters as of_nodes
from ropeway.graph.parameter_server import ParameterServer
from ropeway.graph.parameters import ParameterDescription, ParameterValue, type_of

__all__ = ["AtMaster", "AtNode", "Parameters", "label_of", "parameters_of", "place_name"]


class Parameters(Protocol):
    """The parameters of one node, or (ROS 1) below one name. Answers are as in ``ropeway.graph.parameters``."""

    async def list(self, prefixes: Sequence[str] = ()) -> list[str]:
        """Return the names."""

    async def get(self, names: Sequence[str]) -> dict[str, Any]:
        """Return the values."""

    async def set(self, values: Mapping[str, ParameterValue]) -> dict[str, str | None]:
        """Set values."""

    async def delete(self, names: Sequence[str]) -> dict[str, str | None]:
        """Delete parameters."""

    async def describe(self, names: Sequence[str]) -> dict[str, ParameterDescription | None]:
        """Return what is known of parameters."""

    async def dump(self) -> dict[str, Any]:
        """Return all values."""


class AtNode:
    """Asks the parameter services of a node."""

    def __init__(self, session: OpenGraph, node: str, timeout_s: float) -> None:
        self._whom = (session.graph, session.registry, node)
        self._timeout_s = timeout_s

    async def list(self, prefixes: Sequence[str] = ()) -> list[str]:
        """See ``Parameters``."""
        return await of_nodes.list_parameters(*self._whom, prefixes=prefixes, timeout_s=self._timeout_s)

    async def get(self, names: Sequence[str]) -> dict[str, Any]:
        """See ``Parameters``."""
        return dict(await of_nodes.get_parameters(*self._whom, names, timeout_s=self._timeout_s))

    async def set(self, values: Mapping[str, ParameterValue]) -> dict[str, str | None]:
        """See ``Parameters``."""
        return await of_nodes.set_parameters(*self._whom, values, timeout_s=self._timeout_s)

    async def delete(self, names: Sequence[str]) -> dict[str, str | None]:
        """See ``Parameters``."""
        return await of_nodes.delete_parameters(*self._whom, names, timeout_s=self._timeout_s)

    async def describe(self, names: Sequence[str]) -> dict[str, ParameterDescription | None]:
        """See ``Parameters``."""
        return await of_nodes.describe_parameters(*self._whom, names, timeout_s=self._timeout_s)

    async def dump(self) -> dict[str, Any]:
        """See ``Parameters``."""
        return await self.get(await self.list())


class AtMaster:
    """Asks the parameter server of ROS 1 for what stands below ``namespace``; names may have slashes."""

    def __init__(self, server: ParameterServer, namespace: str) -> None:
        self._server, self._namespace = server, namespace.rstrip("/")

    async def list(self, prefixes: Sequence[str] = ()) -> list[str]:
        """See ``Parameters``; the names are absolute."""
        below = [self._full(prefix) for prefix in prefixes or [""]]
        names = await self._server.list_params()
        return [name for name in names if any(name == start or name.startswith(f"{start}/") for start in below)]

    async def get(self, names: Sequence[str]) -> dict[str, Any]:
        """See ``Parameters``; the value of a namespace is a dict."""
        return {name: await self._value(self._full(name)) for name in names}

    async def set(self, values: Mapping[str, ParameterValue]) -> dict[str, str | None]:
        """See ``Parameters``."""
        refused: dict[str, str | None] = {}
        for name, value in values.items():
            try:
                await self._server.set_param(self._full(name), value)
                refused[name] = None
            except ValueError as error:
                refused[name] = str(error)
        return refused

    async def delete(self, names: Sequence[str]) -> dict[str, str | None]:
        """See ``Parameters``."""
        refused: dict[str, str | None] = {}
        for name in names:
            try:
                await self._server.delete_param(self._full(name))
                refused[name] = None
            except KeyError:
                refused[name] = "it is not set"
        return refused

    async def describe(self, names: Sequence[str]) -> dict[str, ParameterDescription | None]:
        """End the verb: ROS 1 has no such thing."""
        fail(f"the ROS 1 master keeps no descriptions of parameters; see `ropeway param get` for {', '.join(names)}")

    async def dump(self) -> dict[str, Any]:
        """See ``Parameters``; namespaces are dicts, as ``rosparam dump`` prints them."""
        value = await self._value(self._namespace or "/")
        if isinstance(value, dict):
            return value
        return {} if value is None else {self._namespace.rpartition("/")[2]: value}

    def _full(self, name: str) -> str:
        return f"{self._namespace}/{name.strip('/')}".rstrip("/")

    async def _value(self, full: str) -> Any:
        try:
            return await self._server.get_param(full)
        except KeyError:
            return None


def parameters_of(session: OpenGraph, node: str, timeout_s: float) -> Parameters:
    """Return the parameters of ``node``, each answer within ``timeout_s``."""
    if isinstance(session.graph, ParameterServer):
        return AtMaster(session.graph, node)
    return AtNode(session, node, timeout_s)


def place_name(node: str) -> str:
    """Return the absolute name of a node, or of a namespace of ROS 1, or end with a sentence."""
    return "/" if node == "/" else full_name(node)


def label_of(value: Any) -> str:
    """Return the type of a value as ``ros2 param`` writes it; a master of ROS 1 has others, too."""
    try:
        return type_of(value).label
    except ValueMismatch:
        return "dictionary" if isinstance(value, dict) else "list"
