"""Reads and sets parameters for viewers, and tells them of changes.

A parameter has its node before it, ``/turtlesim.background_r``, as foxglove_bridge has it. Reading those of a node is a
call of its ``get_parameters``, setting one a call of ``set_parameters``: roles allow the one and the other as they do
for every service. A ROS 1 master keeps parameters without nodes; there the rights are those to rosapi's ``get_param``
and ``set_param``.
"""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Any, Final, Protocol

from ropeway import aio
from ropeway.errors import CallTimeout, RopewayError
from ropeway.graph.parameter_server import ParameterServer
from ropeway.graph.parameters import get_parameters, list_parameters, nodes_with_parameters, set_parameters
from ropeway.networks.foxglove.values import shown_parameter, wanted_value
from ropeway.tasks import end

if TYPE_CHECKING:
    from ropeway.hub.hub import View
    from ropeway.listener.authorization import Access
    from ropeway.networks.foxglove.settings import FoxgloveSettings
    from ropeway.networks.foxglove.wire import GivenParameter
    from ropeway.types import TypeRegistry

__all__ = ["MASTER_SERVICES", "MasterParameters", "NodeParameters", "ParameterSource", "parameter_source"]

log = logging.getLogger("ropeway.server")

_NODE_S: Final = 2.0  # a node that does not answer must not spoil the answers of the others
_AT_A_TIME: Final = 16  # nodes that are asked
_LATE: Final = "a node did not answer in time"

MASTER_SERVICES: Final = frozenset(("/rosapi/get_param", "/rosapi/set_param"))
"""The services whose rights count for the parameters of a master."""

Complain = Callable[[str], None]


class ParameterSource(Protocol):
    """Knows the parameters of a graph. What it cannot do of a request it tells with ``complain``, and does the rest."""

    async def get(self, names: Sequence[str], access: Access, complain: Complain) -> list[dict[str, Any]]:
        """Return the parameters of these names as viewers read them, all of them where no name is given."""
        ...

    async def set(self, given: Sequence[GivenParameter], access: Access, complain: Complain) -> None:
        """Set parameters."""
        ...

    def may_read(self, name: str, access: Access) -> bool:
        """Return whether a viewer may read a parameter."""
        ...


def parameter_source(
    view: View, registry: TypeRegistry, settings: FoxgloveSettings, timeout_s: float
) -> ParameterSource:
    """Return the source of the parameters of a graph: its master where it has one, else its nodes."""
    graph = view.hub.graph
    if isinstance(graph, ParameterServer):
        return MasterParameters(graph, settings, timeout_s)
    return NodeParameters(view, registry, settings, timeout_s)


class NodeParameters:
    """Asks the nodes of ROS 2. ``timeout_s`` bounds each request as a whole."""

    def __init__(self, view: View, registry: TypeRegistry, settings: FoxgloveSettings, timeout_s: float) -> None:
        self._view, self._registry, self._settings, self._timeout_s = view, registry, settings, timeout_s
        self._turns = asyncio.Semaphore(_AT_A_TIME)

    def may_read(self, name: str, access: Access) -> bool:
        """See ``ParameterSource.may_read``."""
        node = name.partition(".")[0]
        return self._settings.shows_param(name) and access.allows("call_service", f"{node}/get_parameters")

    async def get(self, names: Sequence[str], access: Access, complain: Complain) -> list[dict[str, Any]]:
        """See ``ParameterSource.get``."""
        served = nodes_with_parameters(self._view.services())
        if names:
            wanted = _by_node(names, complain)
            for node in [node for node in wanted if node not in served]:
                del wanted[node]
                complain(f"{node} has no parameter services")
        else:
            wanted = {node: [] for node in served if self._settings.include_hidden or "/_" not in node}
            wanted = {node: [] for node in wanted if access.allows("call_service", f"{node}/get_parameters")}
        found = await self._of_each(wanted, lambda node: self._get(node, wanted[node], access), complain)
        shown = [shown_parameter(f"{node}.{name}", value) for node, has in found.items() for name, value in has.items()]
        return [parameter for parameter in shown if self._settings.shows_param(parameter["name"])]

    async def _get(self, node: str, names: list[str], access: Access) -> Mapping[str, Any]:
        access.check("call_service", f"{node}/get_parameters")
        timeout_s = min(_NODE_S, self._timeout_s)
        view, registry = self._view, self._registry
        wanted = names or await list_parameters(view, registry, node, timeout_s=timeout_s)
        return await get_parameters(view, registry, node, wanted, timeout_s=timeout_s)

    async def set(self, given: Sequence[GivenParameter], access: Access, complain: Complain) -> None:
        """See ``ParameterSource.set``."""
        by_node: dict[str, dict[str, GivenParameter]] = {}
        for parameter in given:
            for node, names in _by_node([parameter.name], complain).items():
                if self._settings.shows_param(parameter.name):
                    by_node.setdefault(node, {})[names[0]] = parameter
                else:
                    complain(f"{parameter.name} is not among the parameters of param_whitelist")

        async def set_those(node: str) -> Mapping[str, str | None]:
            access.check("call_service", f"{node}/set_parameters")
            wanted = by_node[node]
            access.command("call_service", f"{node}/set_parameters")
            view, registry, timeout_s = self._view, self._registry, min(_NODE_S, self._timeout_s)
            now = await get_parameters(view, registry, node, wanted, timeout_s=timeout_s)
            values = {name: wanted_value(parameter, now[name]) for name, parameter in wanted.items()}
            return await set_parameters(view, registry, node, values, timeout_s=timeout_s)

        for node, refused in (await self._of_each(by_node, set_those, complain)).items():
            for name, why in refused.items():
                if why is not None:
                    complain(f"{node}.{name} was not set: {why or 'the node refused it'}")

    async def _of_each(
        self, nodes: Mapping[str, Any], ask: Callable[[str], Any], complain: Complain
    ) -> dict[str, Mapping[str, Any]]:
        """Ask several nodes at a time; return what those said that answered."""
        found: dict[str, Mapping[str, Any]] = {}

        async def one(node: str) -> None:
            async with self._turns:
                try:
                    found[node] = await ask(node)
                except CallTimeout:
                    complain(f"{node} did not answer in time")
                except RopewayError as error:
                    complain(f"{node}: {error}")

        tasks = [asyncio.create_task(one(node), name=f"parameters of {node[:100]}") for node in nodes]
        try:
            if tasks:
                _, late = await asyncio.wait(tasks, timeout=self._timeout_s)
                if late:
                    complain(_LATE)
        finally:
            await end(*tasks)
        return {node: found[node] for node in nodes if node in found}


class MasterParameters:
    """Asks the master of ROS 1."""

    def __init__(self, server: ParameterServer, settings: FoxgloveSettings, timeout_s: float) -> None:
        self._server, self._settings, self._timeout_s = server, settings, timeout_s

    def may_read(self, name: str, access: Access) -> bool:
        """See ``ParameterSource.may_read``."""
        return self._settings.shows_param(name) and access.allows("call_service", "/rosapi/get_param")

    async def get(self, names: Sequence[str], access: Access, complain: Complain) -> list[dict[str, Any]]:
        """See ``ParameterSource.get``."""
        shown = []
        try:
            access.check("call_service", "/rosapi/get_param")
            async with aio.timeout(self._timeout_s):
                for name in names or await self._server.list_params():
                    if not self._settings.shows_param(name):
                        continue
                    try:
                        shown.append(shown_parameter(name, await self._server.get_param(name)))
                    except KeyError:
                        shown.append(shown_parameter(name, None))
        except TimeoutError:
            complain("the master did not answer in time")
        except RopewayError as error:
            complain(str(error))
        return shown

    async def set(self, given: Sequence[GivenParameter], access: Access, complain: Complain) -> None:
        """See ``ParameterSource.set``."""
        try:
            access.check("call_service", "/rosapi/set_param")
            access.command("call_service", "/rosapi/set_param")
            async with aio.timeout(self._timeout_s):
                for parameter in given:
                    await self._set(parameter, complain)
        except TimeoutError:
            complain("the master did not answer in time")
        except RopewayError as error:
            complain(str(error))

    async def _set(self, parameter: GivenParameter, complain: Complain) -> None:
        if not self._settings.shows_param(parameter.name):
            complain(f"{parameter.name} is not among the parameters of param_whitelist")
            return
        try:
            if not parameter.given:
                await self._server.delete_param(parameter.name)
                return
            value = parameter.value
            if parameter.type == "float64" and isinstance(value, int):
                value = float(value)
            await self._server.set_param(parameter.name, value)
        except KeyError:
            complain(f"there is no parameter {parameter.name}")
        except ValueError as error:
            complain(f"{parameter.name} was not set: {error}")


def _by_node(names: Sequence[str], complain: Complain) -> dict[str, list[str]]:
    """Return the parameters of each node that names tell; what is no name is told."""
    found: dict[str, list[str]] = {}
    for name in names:
        node, dot, parameter = name.partition(".")
        if not dot or not parameter or not node.strip("/"):
            complain(f"{name[:200]!r} names no parameter; expected /node.parameter")
            continue
        found.setdefault(node if node.startswith("/") else f"/{node}", []).append(parameter)
    return found
