"""Explains the routes of a running gateway."""

from __future__ import annotations

import time
from collections.abc import AsyncIterator, Iterable, Mapping, Sequence
from contextlib import AsyncExitStack, asynccontextmanager
from typing import Final

from ropeway.bridge.topic import TopicBridge
from ropeway.gateway.bridges import INWARD
from ropeway.gateway.config.config import Route
from ropeway.gateway.config.suggest import did_you_mean
from ropeway.gateway.explain.ends import publishers, readers, servers
from ropeway.gateway.explain.explanation import Explanation, Finding, Subject
from ropeway.gateway.remote import Remote, shown_address
from ropeway.gateway.route import Bridge, RunningRoute
from ropeway.graph.base import Graph
from ropeway.graph.link_parts import ToldByPeer

__all__ = ["explain", "explain_route", "reason_of", "without_route"]


_MOMENT_S: Final = 2.0  # counts come once a second


async def explain(remotes: Sequence[Remote], name: str, to: str = "") -> list[Explanation]:
    """Explain every route of a name, local or remote; ``to`` chooses remotes by a part of address, title or name.

    A name without a route is explained, too. The remote's half is asked over the link, and cut to what it lets us see.
    """
    chosen = [remote for remote in remotes if to in _names(remote)] if to else list(remotes)
    found: list[Explanation] = []
    for remote in chosen:
        mine = [running for running in remote.joined() if name in (running.route.name, running.route.remote_name)]
        if mine:
            async with _far_graph(remote) as far:
                found += [explain_route(remote, running, far) for running in mine]
    if found:
        return found
    routes = [running.route for remote in chosen for running in remote.joined()]
    return [without_route(name, to, list(map(_names, remotes)), (n for r in routes for n in (r.name, r.remote_name)))]


def explain_route(remote: Remote, running: RunningRoute, far: Graph | None = None) -> Explanation:
    """Explain one route as it stands. ``far`` shows the remote's half, ``None`` where the link itself shows it."""
    route, bridge = running.route, running.bridge
    inward = route.operation in INWARD
    there = remote.graph if far is None else far
    local = bridge.target if inward else bridge.source
    source, target = (there, local) if inward else (local, there)
    source_name, target_name = (route.remote_name, route.name) if inward else (route.name, route.remote_name)
    link = [*_link(remote), *_rights(remote, running)]
    if isinstance(bridge, TopicBridge):
        begin = publishers(source, source_name, route.type, route.options.qos)
        end = _read(bridge, target, target_name, route)
    else:
        begin, end = servers(source, "service" if route.kind == "service" else "action", source_name, route.type), []
    if remote.state != "connected":  # then nobody knows what is there
        begin, end = ([], end) if inward else (begin, [])
    chain = [*link, *begin, *end] if inward else [*begin, *link, *end]
    here = local.name
    return Explanation(
        name=route.name,
        kind=route.kind,
        source=shown_address(remote.config) if inward else here,
        target=here if inward else shown_address(remote.config),
        path=route.path,
        findings=(*_without_doubles(chain), *_traffic(bridge), *_far_traffic(bridge, shown_address(remote.config))),
    )


def reason_of(remote: Remote, running: RunningRoute) -> Finding | None:
    """Return why nothing crosses on a route now, as far as this gateway knows; ``None`` where nothing is in the way."""
    return next((finding for finding in explain_route(remote, running).findings if finding.ok is False), None)


def _names(remote: Remote) -> str:
    """Return what a remote may be called by."""
    names = (shown_address(remote.config), remote.config.title, str(remote.status().get("gateway", "")))
    return " ".join(filter(None, names))


@asynccontextmanager
async def _far_graph(remote: Remote) -> AsyncIterator[Graph | None]:
    """Yield a graph that shows what the remote has, ``None`` where the link itself does."""
    async with AsyncExitStack() as stack:
        yield await remote.look(stack) if remote.state == "connected" else None


def without_route(name: str, to: str, addresses: Sequence[str], names: Iterable[str]) -> Explanation:
    """Explain a name that no route carries, or a remote that is not there: tell the nearest of what is."""
    if to and not any(to in address for address in addresses):
        near = did_you_mean(to, addresses)
        text = f"no remote is called {to}{near}; there are {', '.join(addresses) or 'none'}"
    else:
        text = f"no route of the configuration carries {name}{did_you_mean(name, names)}"
    return Explanation(name, "", "", to, findings=(Finding(Subject.ROUTE, False, text),))


def _link(remote: Remote) -> Iterable[Finding]:
    address, state = shown_address(remote.config), remote.state
    error = str(remote.status().get("error") or "")
    if state == "connected":
        yield Finding(Subject.LINK, True, f"{address} is connected", address)
    else:
        yield Finding(Subject.LINK, False, f"{address} is {state}{f': {error}' if error else ''}", address)


def _rights(remote: Remote, running: RunningRoute) -> Iterable[Finding]:
    """Yield what the route itself, or the remote, says against it."""
    address, route, doubt = shown_address(remote.config), running.route, running.doubt
    error = running.status(remote.state).error
    if error and not (doubt is not None and error == doubt.reason):  # that will be found again, if it is still so
        yield Finding(Subject.RIGHTS, False, error, address, route.path)
    elif remote.state == "connected":
        yield Finding(Subject.RIGHTS, True, f"{address} takes the route", address, route.path)


def _read(bridge: TopicBridge, target: Graph, topic: str, route: Route) -> list[Finding]:
    """Return who reads on the target. How many there are is what the bridge acts on; the graph tells who they are."""
    publisher = bridge.publisher
    if publisher is None:
        return []
    count, found = publisher.subscribers, readers(target, topic, route.type, publisher.qos)
    if found[0].ok:
        return found
    if count is None:
        text = f"{target.name} does not tell who reads {topic}, so it is sent"
        return [Finding(Subject.READERS, None, text, target.name)]
    if count:
        return [Finding(Subject.READERS, True, f"{count} reader{'s' if count > 1 else ''} of {topic}", target.name)]
    return found


def _traffic(bridge: Bridge) -> Iterable[Finding]:
    if isinstance(bridge, TopicBridge):
        meter = bridge.meter
        drops = _counts({reason.value: n for reason, n in bridge.drops.items()})
        text = "no message has come yet"
        if meter.messages:
            text = f"{meter.messages} messages, {meter.rate_hz:.1f} Hz now{_since(meter.passed_s)}"
        yield Finding(
            Subject.TRAFFIC, True if meter.messages else None, text + (f"; dropped: {drops}" if drops else "")
        )
    else:
        ended = _counts(bridge.counts)
        yield Finding(Subject.TRAFFIC, None, f"requests: {ended}" if ended else "no request has come yet")


def _far_traffic(bridge: Bridge, address: str) -> Iterable[Finding]:
    """Yield what the remote says of the topic: it tells each client of its own topics alone, once a second."""
    if not isinstance(bridge, TopicBridge):
        return
    parts: tuple[object, ...] = (bridge.publisher, bridge.subscription)
    far = next((part.far for part in parts if isinstance(part, ToldByPeer) and part.far is not None), None)
    if far is None:
        return
    drops = _counts(far.drops)
    text = f"{far.messages} messages have passed {address}{_since(far.passed_s)}"
    text += f", which dropped {drops}" if drops else ""
    yield Finding(Subject.TRAFFIC, True if far.messages else False if drops else None, text, address)


def _since(passed_s: float | None) -> str:
    """Return when the last message passed, where that is more than a moment ago."""
    ago_s = 0.0 if passed_s is None else time.monotonic() - passed_s
    return f", the last one {ago_s:.0f} s ago" if ago_s >= _MOMENT_S else ""


def _counts(counts: Mapping[str, int]) -> str:
    return ", ".join(f"{n} {what}" for what, n in counts.items() if n)


def _without_doubles(findings: Iterable[Finding]) -> list[Finding]:
    """Return findings without those that say again what one before them says, as a route's error about its link."""
    kept: list[Finding] = []
    for finding in findings:
        if not any(finding.text in other.text for other in kept):
            kept.append(finding)
    return kept
