"""Finds out what the two ends of a route show: who publishes, reads or serves a name, as what, with which QoS."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Final, Literal, TypeVar

from ropeway.gateway.config.suggest import nearest
from ropeway.gateway.explain.explanation import Finding, Subject
from ropeway.graph.base import EndpointInfo, Graph, look_up
from ropeway.graph.calls import ActionInfo, ProviderInfo, ServiceInfo
from ropeway.graph.peer_answer import Telling
from ropeway.qos import QoS, unmet

__all__ = ["publishers", "readers", "servers"]

E = TypeVar("E", EndpointInfo, ProviderInfo)

_NAMED: Final = 3  # nodes that a sentence names


def publishers(graph: Graph, topic: str, type: str, qos: QoS | None) -> list[Finding]:
    """Return who publishes a topic on a graph, as which type, and whether a reader that asks for ``qos`` gets it."""
    info = look_up(graph, "topic", topic)
    offers = _others(info.publishers) if info is not None else []
    if not offers:
        near = nearest(topic, [name for name, info in graph.topics().items() if _others(info.publishers)])
        return [_nobody(graph, f"nobody publishes {topic}", near)]
    fitting = [offer for offer in offers if offer.type in ("", type)]
    found = [
        Finding(Subject.SOURCE, True, f"{_count(offers, 'publisher')} of {topic}{_nodes(offers)}", graph.name),
        _type(graph, topic, type, offers, fitting, "published"),
    ]
    misfits = [unmet(offer.qos, qos) for offer in fitting]
    if any(misfits):
        which = "every publisher offers" if all(misfits) else "a publisher offers"
        text = f"{which} incompatible QoS ({_policies(misfits)}); leave out qos to adopt it"
        found.append(Finding(Subject.QOS, not all(misfits), text, graph.name))
    elif fitting:
        text = "the publishers' QoS is adopted" if qos is None else "the publishers offer the QoS that is asked for"
        found.append(Finding(Subject.QOS, True, text, graph.name))
    return found


def readers(graph: Graph, topic: str, type: str, qos: QoS) -> list[Finding]:
    """Return who reads a topic on a graph, as which type, and whether a publisher that offers ``qos`` reaches them."""
    info = look_up(graph, "topic", topic)
    asked = _others(info.subscriptions) if info is not None else []
    if not asked:
        near = nearest(topic, [name for name, info in graph.topics().items() if _others(info.subscriptions)])
        text = f"nobody reads {topic} on {graph.name}, so it is not sent{_meant(near)}"
        return [Finding(Subject.READERS, False, text, graph.name, near=near)]
    fitting = [reader for reader in asked if reader.type in ("", type)]
    found = [
        Finding(Subject.READERS, True, f"{_count(asked, 'reader')} of {topic}{_nodes(asked)}", graph.name),
        _type(graph, topic, type, asked, fitting, "read"),
    ]
    misfits = [unmet(qos, reader.qos) for reader in fitting]
    if any(misfits):
        which = "every reader asks" if all(misfits) else "a reader asks"
        text = f"{which} for more than the publisher offers ({_policies(misfits)})"
        found.append(Finding(Subject.QOS, not all(misfits), text, graph.name))
    return found


def servers(graph: Graph, kind: Literal["service", "action"], name: str, type: str) -> list[Finding]:
    """Return who serves a service or an action on a graph, and as which type."""
    info = look_up(graph, kind, name)
    there = _others(info.servers) if info is not None else []
    if info is None or not there:
        offered: Mapping[str, ServiceInfo | ActionInfo] = graph.services() if kind == "service" else graph.actions()
        near = nearest(name, [other for other, found in offered.items() if _others(found.servers)])
        return [_nobody(graph, f"nobody serves {name}", near)]
    said = f"{name} is {', '.join(info.types)} on {graph.name}"
    fitting = not info.types or type in info.types
    return [
        Finding(Subject.SOURCE, True, f"{_count(there, 'server')} of {name}{_nodes(there)}", graph.name),
        Finding(Subject.TYPE, fitting, said if fitting else f"{said}, and the route says {type}", graph.name),
    ]


def _nobody(graph: Graph, text: str, near: str) -> Finding:
    """Return why a name has no source: its peer tells nothing, nobody else is on the network, or it is not there."""
    if isinstance(graph, Telling) and graph.untold:
        return Finding(Subject.SOURCE, None, f"{graph.name} does not tell what is there: {graph.untold}", graph.name)
    if not near and _alone(graph):
        hint = "; is it the right domain (ROS_DOMAIN_ID), and the right interface?" if graph.kind == "dds" else ""
        return Finding(Subject.NETWORK, False, f"nobody else is on {graph.name}, so {text}{hint}", graph.name)
    return Finding(Subject.SOURCE, False, f"{text} on {graph.name}{_meant(near)}", graph.name, near=near)


def _meant(near: str) -> str:
    return f"; did you mean {near}?" if near else ""


def _alone(graph: Graph) -> bool:
    if any(not node.local for node in graph.nodes().values()):
        return False
    return not any(_others(info.publishers) or _others(info.subscriptions) for info in graph.topics().values())


def _type(
    graph: Graph, topic: str, type: str, ends: Sequence[EndpointInfo], fitting: Sequence[EndpointInfo], verb: str
) -> Finding:
    types = sorted({end.type for end in ends if end.type})
    if not types:
        return Finding(Subject.TYPE, None, f"{graph.name} does not tell the type of {topic}", graph.name)
    said = f"{topic} is {verb} as {', '.join(types)} on {graph.name}"
    if types == [type]:
        return Finding(Subject.TYPE, True, said, graph.name)
    return Finding(Subject.TYPE, bool(fitting), f"{said}, and the route says {type}", graph.name)


def _others(ends: Iterable[E]) -> list[E]:
    return [end for end in ends if not end.local]


def _policies(misfits: Iterable[tuple[str, ...]]) -> str:
    return ", ".join(sorted({policy for policies in misfits for policy in policies})).upper()


def _count(ends: Sequence[object], word: str) -> str:
    return f"{len(ends)} {word}{'s' if len(ends) != 1 else ''}"


def _nodes(ends: Iterable[EndpointInfo | ProviderInfo]) -> str:
    names = sorted({end.node for end in ends if end.node})
    more = f" and {len(names) - _NAMED} more" if len(names) > _NAMED else ""
    return f" ({', '.join(names[:_NAMED])}{more})" if names else ""
