"""Pairs of topics that a group cannot take latencies from: seldom meant, often mistyped."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING, Final

from ropeway.gateway.config.policy_model import ROBOT, SERVICE
from ropeway.gateway.config.suggest import did_you_mean
from ropeway.graph.base import resolve_name

if TYPE_CHECKING:
    from ropeway.gateway.config.config import Config
    from ropeway.gateway.config.group_model import AnycastConfig
    from ropeway.gateway.config.model import RemoteConfig

__all__ = ["group_hints", "remote_hints"]

_OTHER_END: Final = {"pub": "sub", "sub": "pub"}


def group_hints(config: Config) -> list[tuple[str, str]]:
    """Return which topics of the groups of a configuration tell no latency, with their paths."""
    return [
        (f"remotes[{index}].anycast.{path}", text)
        for index, remote in enumerate(config.remotes)
        for path, text in remote_hints(remote)
    ]


def remote_hints(remote: RemoteConfig) -> list[tuple[str, str]]:
    """Return which topics of a group are asked or answered on one side alone, with paths below its ``anycast``.

    This may be right: their routes can be added while the gateway runs.
    """
    anycast = remote.anycast
    return [] if anycast is None else [*_responses(remote, anycast), *_states(anycast)]


def _responses(remote: RemoteConfig, anycast: AnycastConfig) -> Iterator[tuple[str, str]]:
    if remote.automatic:
        return
    published = {remote.names(item)[0] for item in (*remote.publish, *remote.trans_publish)}
    subscribed = {remote.names(item)[0] for item in remote.subscribe}
    for request, response in anycast.responses.items():
        for topic, key, crossing in ((request, "publish", published), (response, "subscribe", subscribed)):
            if resolve_name(topic) not in crossing:
                near = did_you_mean(resolve_name(topic), crossing)
                yield "responses", f'{topic} is not in "{key}" of this remote, so no latency comes of it{near}'


def _states(anycast: AnycastConfig) -> Iterator[tuple[str, str]]:
    """Compare the topics of the robot with those of the service; with ``responses`` they are not needed."""
    robot, service = (anycast.state_definition.get(name) for name in (ROBOT, SERVICE))
    if robot is None or service is None or anycast.responses:
        return
    for topic, way in service.topics.items():
        other = _OTHER_END[way]
        if robot.topics.get(topic) != other:
            near = did_you_mean(topic, [name for name, its in robot.topics.items() if its == other])
            text = f'{topic} is "{way}" here and not "{other}" in state {ROBOT}, so no latency comes of it{near}'
            yield f"state_definition.{SERVICE}.topics", text
