"""Shows what the master knows as topics, services, actions and nodes, and what has changed since the last poll."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from typing import Final

from ropeway.errors import InvalidTypeName
from ropeway.graph.base import EndpointInfo, GraphEvent, NodeInfo, TopicInfo
from ropeway.graph.calls import ActionInfo, ProviderInfo, ServiceInfo
from ropeway.qos import DEFAULT, QoS
from ropeway.types.definition import canonical_name

__all__ = ["ACTION_TOPICS", "Names", "Ros1Snapshot", "State"]

Names = Mapping[str, Iterable[str]]
"""Topics or services to the nodes that have them."""

ACTION_TOPICS: Final = ("goal", "cancel", "status", "feedback", "result")
_STATUS_TYPE: Final = "actionlib_msgs/GoalStatusArray"
_CANCEL_TYPE: Final = "actionlib_msgs/GoalID"
_SHOWN_BY: Final = {"goal": "ActionGoal", "feedback": "ActionFeedback", "result": "ActionResult"}

_Facts = dict[tuple[str, str, str], str]  # kind, name, node → type


@dataclass(slots=True)
class State:
    """The master's system state, with the types of topics and services in ROS 2's spelling, as far as known."""

    publishers: dict[str, list[str]] = field(default_factory=dict)
    subscribers: dict[str, list[str]] = field(default_factory=dict)
    services: dict[str, list[str]] = field(default_factory=dict)
    topic_types: dict[str, str] = field(default_factory=dict)
    service_types: dict[str, str] = field(default_factory=dict)


class Ros1Snapshot:
    """The graph ``graph`` as node ``own`` sees it.

    ``qos`` tells the profile of a publisher (topic, node) where a connection to it has shown it.
    """

    def __init__(self, graph: str, own: Callable[[], str], qos: Callable[[str, str], QoS | None]) -> None:
        self.graph = graph
        self.state = State()
        self._own, self._qos = own, qos
        self._facts: _Facts = {}
        self._actions: dict[str, str] = {}

    def update(self, state: State) -> list[GraphEvent]:
        """Take over a new state; gives what came and went, our own parts left out."""
        self.state = state
        self._actions = _find_actions(state)
        facts = self._all_facts()
        events = [
            GraphEvent(False, kind, name, type, node, self.graph)
            for (kind, name, node), type in self._facts.items()
            if (kind, name, node) not in facts
        ]
        events += [
            GraphEvent(True, kind, name, type, node, self.graph)
            for (kind, name, node), type in facts.items()
            if (kind, name, node) not in self._facts
        ]
        self._facts = facts
        return events

    def _all_facts(self) -> _Facts:
        facts: _Facts = {}
        state, own = self.state, self._own()
        hidden = self._hidden()
        for kind, table in (("publisher", state.publishers), ("subscription", state.subscribers)):
            for topic, nodes in table.items():
                for node in nodes:
                    facts["node", node, ""] = ""
                    if node != own and topic not in hidden:
                        facts[kind, topic, node] = state.topic_types.get(topic, "")
        for service, nodes in state.services.items():
            for node in nodes:
                facts["node", node, ""] = ""
                if node != own and service in state.service_types:
                    facts["service", service, node] = state.service_types[service]
        for action, type in self._actions.items():
            for node in self._servers(action):
                if node != own:
                    facts["action", action, node] = type
        facts.pop(("node", own, ""), None)
        return facts

    def _servers(self, action: str) -> list[str]:
        state = self.state
        hears = set(state.subscribers.get(f"{action}/goal", ()))
        return [node for node in state.publishers.get(f"{action}/result", ()) if node in hears]

    def _hidden(self) -> set[str]:
        return {f"{action}/{part}" for action in self._actions for part in ACTION_TOPICS}

    def served(self, service: str) -> bool:
        """Return whether a node other than ours serves it."""
        own = self._own()
        return any(node != own for node in self.state.services.get(service, ()))

    def topics(self) -> dict[str, TopicInfo]:
        """Return all topics except those that belong to actions."""
        state, hidden = self.state, self._hidden()
        out: dict[str, TopicInfo] = {}
        for topic in sorted({*state.publishers, *state.subscribers} - hidden):
            type = state.topic_types.get(topic, "")
            ends = [
                [self._endpoint(kind, topic, type, node) for node in table.get(topic, ())]
                for kind, table in (("publisher", state.publishers), ("subscription", state.subscribers))
            ]
            out[topic] = TopicInfo(topic, (type,) if type else (), tuple(ends[0]), tuple(ends[1]))
        return out

    def _endpoint(self, kind: str, topic: str, type: str, node: str) -> EndpointInfo:
        qos = self._qos(topic, node) if kind == "publisher" else None
        return EndpointInfo(kind, topic, type, qos or DEFAULT, node=node, local=node == self._own())

    def services(self) -> dict[str, ServiceInfo]:
        """Return all services whose providers were asked for the type, even if they did not answer."""
        state, own = self.state, self._own()
        out: dict[str, ServiceInfo] = {}
        for name, nodes in sorted(state.services.items()):
            if name not in state.service_types:
                continue
            type = state.service_types[name]
            servers = tuple(ProviderInfo(node, local=node == own) for node in nodes)
            out[name] = ServiceInfo(name, (type,) if type else (), servers)
        return out

    def actions(self) -> dict[str, ActionInfo]:
        """Return all actions that have a server."""
        own, state = self._own(), self.state
        out: dict[str, ActionInfo] = {}
        for name, type in sorted(self._actions.items()):
            servers = tuple(ProviderInfo(node, local=node == own) for node in self._servers(name))
            clients = tuple(ProviderInfo(node, local=node == own) for node in state.publishers.get(f"{name}/goal", ()))
            out[name] = ActionInfo(name, (type,), servers, clients)
        return out

    def nodes(self) -> dict[str, NodeInfo]:
        """Return all nodes that have anything."""
        state, own = self.state, self._own()
        found: dict[str, tuple[list[tuple[str, str]], ...]] = {}
        for place, table, types in (
            (0, state.publishers, state.topic_types),
            (1, state.subscribers, state.topic_types),
            (2, state.services, state.service_types),
        ):
            for name, nodes in table.items():
                for node in nodes:
                    found.setdefault(node, ([], [], []))[place].append((name, types.get(name, "")))
        return {
            node: NodeInfo(node, tuple(pubs), tuple(subs), tuple(served), local=node == own)
            for node, (pubs, subs, served) in sorted(found.items())
        }


def full_name(ros1: str, kind: str = "msg") -> str:
    """Return ``pkg/msg/Name`` for ROS 1's ``pkg/Name``; ``""`` for ``*`` and invalid names."""
    try:
        return canonical_name(ros1, kind)
    except InvalidTypeName:
        return ""


def _find_actions(state: State) -> dict[str, str]:
    """Return the actions that have a server, with their types."""
    found: dict[str, str] = {}
    types = state.topic_types
    for topic, type in types.items():
        action, _, part = topic.rpartition("/")
        if part != "result" or not action or not type.endswith("ActionResult"):
            continue
        package, _, name = type.partition("/msg/")
        base = name.removesuffix("ActionResult")
        fits = (
            types.get(f"{action}/status") == full_name(_STATUS_TYPE)
            and types.get(f"{action}/cancel", full_name(_CANCEL_TYPE)) == full_name(_CANCEL_TYPE)
            and all(
                types.get(f"{action}/{part}", f"{package}/msg/{base}{end}") == f"{package}/msg/{base}{end}"
                for part, end in _SHOWN_BY.items()
            )
        )
        hears = set(state.subscribers.get(f"{action}/goal", ())) & set(state.subscribers.get(f"{action}/cancel", ()))
        tells = set(state.publishers.get(topic, ())) & set(state.publishers.get(f"{action}/status", ()))
        if base and fits and hears & tells:
            found[action] = f"{package}/action/{base}"
    return found
