"""``Rosapi``: what the node rosapi of rosbridge answers, answered by the server itself."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Awaitable, Callable, Mapping
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import CallFailed, InvalidTypeName, NotServed, TypesError, ValueMismatch
from ropeway.graph.layout_border import Distributed
from ropeway.graph.parameter_server import ParameterServer
from ropeway.listener.globs import Globs
from ropeway.networks.rosbridge.rosapi.master_params import MasterParams
from ropeway.networks.rosbridge.rosapi.params import Params
from ropeway.networks.rosbridge.rosapi.snapshot import GraphSnapshot
from ropeway.types.definition_texts import Ros1Texts, Texts
from ropeway.types.described import DESCRIPTION_SERVICE, DESCRIPTION_TYPE, answer_for
from ropeway.types.rosbridge import ROSBRIDGE_INTERFACES

if TYPE_CHECKING:
    from ropeway.hub.hub import Hub
    from ropeway.types import TypeRegistry
    from ropeway.types.ros1_spelling import Ros1Spelling

__all__ = ["SERVICES", "Rosapi"]

_ROS_VERSION: Final = 2

Values = dict[str, Any]
_Answer = Callable[[Mapping[str, Any]], "Values | Awaitable[Values]"]

_NAMED: Final = {"action_servers": "GetActionServers", "get_ros_version": "GetROSVersion"}
_LISTED: Final = (
    "topics",
    "interfaces",
    "topics_for_type",
    "topics_and_raw_types",
    "services",
    "services_for_type",
    "nodes",
    "node_details",
    "action_servers",
    "action_type",
    "topic_type",
    "service_type",
    "publishers",
    "subscribers",
    "service_providers",
    "service_node",
    "message_details",
    "service_request_details",
    "service_response_details",
    "action_goal_details",
    "action_result_details",
    "action_feedback_details",
    "set_param",
    "get_param",
    "has_param",
    "delete_param",
    "get_param_names",
    "get_time",
    "get_ros_version",
)

SERVICES: Final[dict[str, str]] = {
    name: f"rosapi_msgs/srv/{_NAMED.get(name) or name.title().replace('_', '')}" for name in _LISTED
}
"""The services by their last part, with their types."""

_PARTS: Final = {
    "service_request_details": ("srv", "_Request"),
    "service_response_details": ("srv", "_Response"),
    "action_goal_details": ("action", "_Goal"),
    "action_result_details": ("action", "_Result"),
    "action_feedback_details": ("action", "_Feedback"),
}
_DEFINING: Final = {
    "message_details": ("type", "msg"),
    DESCRIPTION_SERVICE: ("type_name", "msg"),
    **{service: ("type", kind) for service, (kind, _) in _PARTS.items()},
}
"""The services that tell definitions, with the field that names the type, and its middle part if it has none."""
_ROS1_TIMES: Final = ("time", "duration")


class Rosapi:
    """Answers ``/rosapi/topics`` and its kin about the graph of ``hub``, for all clients of a server.

    ``params_timeout_s`` bounds what is asked of other nodes, ``globs`` limit what is shown. ``namespace`` is where the
    services stand: ``/robot1`` makes them ``/robot1/rosapi/topics``. Nothing is created on the network for them, but
    they are listed among the services as those of the original are. ``ros1`` tells that the network is one of ROS 1:
    types have names of two parts there, and the definitions of ROS 1.
    """

    def __init__(
        self,
        hub: Hub,
        registry: TypeRegistry,
        *,
        params_timeout_s: float = 5.0,
        globs: Globs | None = None,
        namespace: str = "/",
        clock: Callable[[], int] = time.time_ns,
        ros1: Ros1Spelling | None = None,
    ) -> None:
        self._ros1 = ros1
        self._registry, self._clock, self._graph = registry, clock, hub.graph
        self._prefix = f"{namespace.rstrip('/')}/rosapi/"
        self._view = hub.view("rosapi")
        self._texts: Texts | Ros1Texts = Texts(registry) if ros1 is None else Ros1Texts(ros1)
        own = {self._prefix + name: type for name, type in SERVICES.items()}
        shown = globs or Globs()
        self._picture = GraphSnapshot(hub.graph, shown, own, lambda: self._view.own_changes.emitted)
        self._params: Params | MasterParams
        if isinstance(hub.graph, ParameterServer):
            self._params = MasterParams(hub.graph, shown, params_timeout_s)
        else:
            self._params = Params(self._view, registry, shown, params_timeout_s)
        self._answers: dict[str, _Answer] = {
            name: getattr(self, f"_{name}", None) or self._details(name) for name in SERVICES
        }
        # For gateways, which need more than the original tells: bounds and constants. It is not listed.
        self._answers[DESCRIPTION_SERVICE] = partial(answer_for, registry)

    def serves(self, name: str) -> bool:
        """Return whether a service is answered here: ``/rosapi/topics``, or ``rosapi/topics``."""
        return self._last_part(name) in self._answers

    async def call(self, name: str, args: Any = None) -> Values:
        """Return the values of the response, in the order of its fields.

        ``args`` is the object or the list that came with the call. Raises ``NotServed`` for a name that is not one of
        rosapi, ``CallFailed`` for arguments that do not fit the request.
        """
        found = self.question(name, args)()
        return found if isinstance(found, dict) else await found

    def question(self, name: str, args: Any) -> Callable[[], Any]:
        """Return what finds the answer of a call; a coroutine function where other nodes have to be asked.

        Raises as ``call`` does.
        """
        service = self._last_part(name)
        answer = self._answers.get(service)
        if answer is None:
            raise NotServed(name if name.startswith("/") else f"/{name}")
        request = self._request(name, SERVICES.get(service, DESCRIPTION_TYPE), args)
        if service in _DEFINING:
            field, kind = _DEFINING[service]
            if not self._registry.has(request[field], kind):
                return partial(self._learned, answer, request, request[field], kind)
        return partial(answer, request)

    async def _learned(self, answer: _Answer, request: Mapping[str, Any], type: str, kind: str) -> Values:
        """Answer once the network was asked for a definition that is not known."""
        with contextlib.suppress(InvalidTypeName):
            await self._view.learn(self._registry.canonical(type, kind))
        found = answer(request)
        assert isinstance(found, dict)
        return found

    async def close(self) -> None:
        """Let go of the graph; calls under way fail."""
        await self._view.close()

    def _last_part(self, name: str) -> str:
        full = name if name.startswith("/") else f"/{name}"
        return full.removeprefix(self._prefix) if full.startswith(self._prefix) else ""

    def _request(self, name: str, type: str, args: object) -> Mapping[str, Any]:
        """Return the request with every field; ``args`` in a list are taken in the order of the fields, null is left
        out.
        """
        codec = self._registry.codec(f"{type}_Request")
        named = dict(zip(codec.fields, args, strict=False)) if isinstance(args, (list, tuple)) else args
        given = {k: v for k, v in named.items() if v is not None} if isinstance(named, Mapping) else {}
        try:
            return codec.decode(codec.from_json(given))
        except ValueMismatch as error:
            raise CallFailed(name, error.reason) from None

    def _spelled(self, type: str) -> str:
        """Return the name of a type as clients of this network write it."""
        if self._ros1 is None:
            return type
        return self._ros1.name(type).replace("rosapi_msgs/", "rosapi/")

    # ── topics ─────────────────────────────────────────────────────────────────────────────────────────────────

    def _topics(self, _: Mapping[str, Any]) -> Values:
        topics = self._picture.topics()
        return {"topics": list(topics), "types": [self._spelled(type) for type in topics.values()]}

    def _topics_for_type(self, request: Mapping[str, Any]) -> Values:
        wanted = self._spelled(request["type"])
        return {"topics": [name for name, type in self._picture.topics().items() if self._spelled(type) == wanted]}

    def _topics_and_raw_types(self, _: Mapping[str, Any]) -> Values:
        topics = self._picture.topics()
        types = list(topics.values())
        return {
            "topics": list(topics),
            "types": [self._spelled(type) for type in types],
            "typedefs_full_text": [self._texts.of(type) for type in types],
        }

    def _topic_type(self, request: Mapping[str, Any]) -> Values:
        return {"type": self._spelled(self._picture.topic_type(request["topic"]))}

    def _publishers(self, request: Mapping[str, Any]) -> Values:
        return {"publishers": self._picture.publishers(request["topic"])}

    def _subscribers(self, request: Mapping[str, Any]) -> Values:
        return {"subscribers": self._picture.subscribers(request["topic"])}

    # ── services, actions, nodes ───────────────────────────────────────────────────────────────────────────────

    def _services(self, _: Mapping[str, Any]) -> Values:
        return {"services": list(self._picture.services())}

    def _services_for_type(self, request: Mapping[str, Any]) -> Values:
        wanted = self._spelled(request["type"])
        return {"services": [name for name, type in self._picture.services().items() if self._spelled(type) == wanted]}

    def _service_type(self, request: Mapping[str, Any]) -> Values:
        return {"type": self._spelled(self._picture.service_type(request["service"]))}

    def _service_providers(self, request: Mapping[str, Any]) -> Values:
        return {"providers": self._picture.providers(request["service"])}

    def _service_node(self, request: Mapping[str, Any]) -> Values:
        return {"node": self._picture.service_node(request["service"])}

    def _action_servers(self, _: Mapping[str, Any]) -> Values:
        return {"action_servers": self._picture.action_servers()}

    def _action_type(self, request: Mapping[str, Any]) -> Values:
        return {"type": self._picture.action_type(request["action"])}

    def _nodes(self, _: Mapping[str, Any]) -> Values:
        return {"nodes": list(self._picture.nodes())}

    def _node_details(self, request: Mapping[str, Any]) -> Values:
        return self._picture.node_details(request["node"])

    # ── definitions ────────────────────────────────────────────────────────────────────────────────────────────

    def _interfaces(self, _: Mapping[str, Any]) -> Values:
        return {"interfaces": self._registry.names()}

    def _message_details(self, request: Mapping[str, Any]) -> Values:
        if request["type"] in _ROS1_TIMES:
            return {"typedefs": [_ros1_time(request["type"])]}
        return self._typedefs(request["type"], "msg", "")

    def _details(self, service: str) -> _Answer:
        kind, end = _PARTS[service]
        return lambda request: self._typedefs(request["type"], kind, end)

    def _typedefs(self, type: str, kind: str, end: str) -> Values:
        """Return the definitions of a message or of one part of a service or action; empty if it is not known."""
        try:
            full = self._registry.canonical(type, kind)
            known = self._registry.has(full) and (not end or full.split("/")[1] == kind)
            if not known:
                return {"typedefs": []}
            return {"typedefs": (self._registry if self._ros1 is None else self._ros1).typedefs(full + end)}
        except TypesError:
            return {"typedefs": []}

    # ── parameters ─────────────────────────────────────────────────────────────────────────────────────────────

    async def _set_param(self, request: Mapping[str, Any]) -> Values:
        return await self._params.set(request["name"], request["value"])

    async def _get_param(self, request: Mapping[str, Any]) -> Values:
        return await self._params.get(request["name"], request["default_value"])

    async def _has_param(self, request: Mapping[str, Any]) -> Values:
        return {"exists": await self._params.has(request["name"])}

    async def _delete_param(self, request: Mapping[str, Any]) -> Values:
        return await self._params.delete(request["name"])

    async def _get_param_names(self, _: Mapping[str, Any]) -> Values:
        return {"names": await self._params.names()}

    # ── time and version ───────────────────────────────────────────────────────────────────────────────────────

    def _get_time(self, _: Mapping[str, Any]) -> Values:
        """Return the time, with the names of ROS 1 beside those of ROS 2: roslibpy reads them."""
        sec, nanosec = divmod(self._clock(), 1_000_000_000)
        return {"time": {"sec": sec, "nanosec": nanosec, "secs": sec, "nsecs": nanosec}}

    def _get_ros_version(self, _: Mapping[str, Any]) -> Values:
        if self._ros1 is not None:
            return {"version": 1, "distro": "noetic"}
        known = self._graph.distro if isinstance(self._graph, Distributed) else ""
        return {"version": _ROS_VERSION, "distro": known or os.environ.get("ROS_DISTRO") or self._registry.distro}


def _ros1_time(name: str) -> Values:
    return {
        "type": name,
        "fieldnames": ["secs", "nsecs"],
        "fieldtypes": ["int32", "int32"],
        "fieldarraylen": [-1, -1],
        "examples": ["0", "0"],
        "constnames": [],
        "constvalues": [],
    }


assert set(SERVICES.values()) == {name for name in ROSBRIDGE_INTERFACES if name.startswith("rosapi_msgs/srv/")}
