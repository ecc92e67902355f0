"""Makes a plan of a gateway's configuration: a host for the gateway, one for each remote, and its topics."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Final

from ropeway.gateway.config.config import Config, Route
from ropeway.gateway.config.expected_model import ExpectedTraffic
from ropeway.gateway.config.fleet import KEY, GatewayFleet
from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.config.route_model import TopicItem
from ropeway.planning.plan import MBIT_BPS, PlannedLink, PlannedTopic, TrafficPlan
from ropeway.planning.prediction import CONFIGURED, predict

__all__ = ["plan_of", "plan_of_fleet", "unfitting"]


NO_HOSTS: Final[Mapping[str, str]] = {}


def plan_of_fleet(
    fleet: GatewayFleet, measured: Mapping[str, PlannedTopic] | None = None, fallback: PlannedLink | None = None
) -> tuple[TrafficPlan, list[str]]:
    """Return the plan of all gateways of a document, and the paths of the topics that are left out; see ``plan_of``."""
    topics: list[PlannedTopic] = []
    links: dict[frozenset[str], PlannedLink] = {}
    unknown: list[str] = []
    for name, config in fleet.members.items():
        hosts = {
            remote.address: fleet.members[there].gateway.name
            for remote in config.remotes
            if (there := fleet.member_at(name, remote.address))
        }
        plan, left_out = plan_of(config, measured, fallback, hosts)
        topics += plan.topics
        for link in plan.links:
            links.setdefault(link.hosts, link)
        unknown += [f"{KEY}.{name}.{path}" for path in left_out]
    return TrafficPlan(tuple(topics), tuple(links.values())), unknown


def plan_of(
    config: Config,
    measured: Mapping[str, PlannedTopic] | None = None,
    fallback: PlannedLink | None = None,
    hosts: Mapping[str, str] = NO_HOSTS,
) -> tuple[TrafficPlan, list[str]]:
    """Return the plan of a configuration, and the paths of the topics that are left out.

    What is expected of a topic comes from its ``expected`` key, else from ``measured``, by local name; without either
    it is left out, and so are the topics of remotes without ``link`` where there is no ``fallback``. ``hosts`` has the
    names of gateways by the addresses at which they are dialled.
    """
    topics: list[PlannedTopic] = []
    links: dict[str, PlannedLink] = {}
    unknown: list[str] = []
    items = {
        f"remotes[{index}].{operation}[{number}]": item
        for index, remote in enumerate(config.remotes)
        for operation, number, item in remote.items()
    }
    for route in config.routes():
        item = items[route.path]
        if not isinstance(item, TopicItem):
            continue
        far = hosts.get(route.remote.address) or _host(route.remote)
        link = _link(route.remote) or fallback
        topic = _topic(route, item, (measured or {}).get(route.name), config.gateway.name, far)
        if topic is None or link is None:
            unknown.append(route.path)
            continue
        topics.append(topic)
        links.setdefault(far, replace(link, hosts=frozenset((config.gateway.name, far))))
    return TrafficPlan(tuple(topics), tuple(links.values())), unknown


def unfitting(config: Config) -> list[str]:
    """Return a sentence for each link that is asked for more than it carries, as far as the configuration says."""
    plan, _ = plan_of(config)
    rows = [row for row in predict(plan, [CONFIGURED]) if not row.fits]
    worst = {(row.way, row.link_bps): row for row in sorted(rows, key=lambda row: -row.shared_hz / row.published_hz)}
    return [
        f"the topics from {here} to {there} ask for {needed_bps / MBIT_BPS:.1f} Mbit/s, and the link carries "
        f"{row.rate_of_link_bps / MBIT_BPS:g}: {row.topic} will arrive at {row.shared_hz:.1f} of "
        f"{row.published_hz:g} Hz; lower rates (rate_hz) or compress, and see ropeway predict"
        for ((here, there), needed_bps), row in worst.items()
    ]


def _host(remote: RemoteConfig) -> str:
    return remote.title or remote.address


def _link(remote: RemoteConfig) -> PlannedLink | None:
    if remote.link is None:
        return None
    return PlannedLink(MBIT_BPS * remote.link.mbit, remote.link.delay_ms / 1e3, duplex=remote.link.duplex)


def _topic(route: Route, item: TopicItem, measured: PlannedTopic | None, here: str, far: str) -> PlannedTopic | None:
    if item.expected is not None:
        topic = _expected(route, item.expected)
    elif measured is not None:
        topic = measured
    else:
        return None
    rate_hz = min(topic.published_hz, route.options.delivery.rate_hz or topic.published_hz)
    source, sink = (far, here) if route.operation == "subscribe" else (here, far)
    return replace(
        topic,
        published_hz=rate_hz,
        publishers={source: sum(topic.publishers.values())},
        readers={sink: sum(topic.readers.values())},
        encoding=route.options.delivery.encoding,
    )


def _expected(route: Route, expected: ExpectedTraffic) -> PlannedTopic:
    return PlannedTopic(
        name=route.name,
        size_bytes=expected.bytes,
        published_hz=expected.hz,
        publishers={"": expected.publishers},
        readers={"": expected.readers},
        type=route.type,
        ratios={} if expected.ratio is None else {route.options.delivery.encoding: expected.ratio},
    )
