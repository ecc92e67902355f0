"""Policies of groups: read from files of their own, given to every group, and checked against what crosses."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from ropeway.errors import ConfigError
from ropeway.gateway.config.address import parse_link
from ropeway.gateway.config.document import read_file
from ropeway.gateway.config.group_model import AnycastConfig
from ropeway.gateway.config.model import Document, RemoteConfig
from ropeway.gateway.config.overlay_model import OVERLAY
from ropeway.gateway.config.policy_model import ROBOT, SERVICE, STANDBY, StateConfig
from ropeway.gateway.config.suggest import did_you_mean, one_of
from ropeway.graph.base import resolve_name

__all__ = ["Policies", "policies_of", "policy_problems", "with_default_policy", "with_policy_files"]

Problem = tuple[str, str]

_KEY: Final = "anycast"
_PREDEFINED: Final = (STANDBY, SERVICE, ROBOT)


@dataclass(frozen=True, slots=True)
class Policies:
    """The states of a group: what they are, and in which each machine begins.

    ``machines`` has the address of each machine, ``initial`` the state of each address; ``me`` is the robot's name.
    """

    states: Mapping[str, StateConfig] = field(default_factory=dict)
    machines: Mapping[str, str] = field(default_factory=dict)
    initial: Mapping[str, str] = field(default_factory=dict)
    me: str = ""
    mine: str = ROBOT


def with_policy_files(full: Mapping[str, Any], directory: Path) -> tuple[Mapping[str, Any], list[Problem]]:
    """Return the document with every ``anycast`` that is the name of a file replaced by what the file holds."""
    problems: list[Problem] = []

    def included(holder: Mapping[str, Any], path: str) -> Mapping[str, Any]:
        name = holder.get(_KEY)
        if not isinstance(name, str):
            return holder
        try:
            found = read_file(directory / Path(name).expanduser())
        except ConfigError as error:
            problems.extend((path, str(ConfigError([problem], name))) for problem in error.problems)
            found = None
        if found is not None and not isinstance(found, Mapping):
            problems.append((path, f"{name}: expected an object with state_definition, latency_bound and the like"))
            found = None
        return {**holder, _KEY: found}

    full = included(full, _KEY)
    remotes = full.get("remotes")
    if isinstance(remotes, list):
        inner = [
            included(remote, f"remotes[{index}].{_KEY}") if isinstance(remote, Mapping) else remote
            for index, remote in enumerate(remotes)
        ]
        full = {**full, "remotes": inner}
    return full, problems


def with_default_policy(document: Document) -> Document:
    """Return the document with its ``anycast`` given to every remote that is a group and has none."""
    if document.anycast is None:
        return document
    remotes = tuple(
        remote.model_copy(update={_KEY: document.anycast})
        if len(remote.addresses) > 1 and remote.anycast is None
        else remote
        for remote in document.remotes
    )
    return document.model_copy(update={"remotes": remotes})


def policy_problems(document: Document) -> list[Problem]:
    """Return what is wrong with the policies of all groups."""
    problems: list[Problem] = []
    if document.anycast is not None and not any(remote.anycast for remote in document.remotes):
        problems.append((_KEY, "no remote is a group; give one several addresses"))
    for index, remote in enumerate(document.remotes):
        if remote.anycast is not None:
            shared = remote.anycast is document.anycast
            path = _KEY if shared else f"remotes[{index}].{_KEY}"
            problems += _problems(remote, remote.anycast, document.gateway.name, path)
    return list(dict.fromkeys(problems))


def policies_of(remote: RemoteConfig, name: str) -> Policies:
    """Return the states of a group, as the gateway ``name`` takes part in it."""
    anycast = remote.anycast or AnycastConfig.model_validate({})
    me = _me(anycast, name)
    others = [machine for machine in anycast.initial_policy if machine != me]
    if remote.address == OVERLAY:  # there machines have names of their own
        machines = dict(zip(others, others, strict=True))
    else:
        named = dict(anycast.machines) or dict(zip(others, remote.addresses, strict=False))
        machines = {machine: parse_link(address) for machine, address in named.items()}
    initial = {
        address: anycast.initial_policy[machine]
        for machine, address in machines.items()
        if machine in anycast.initial_policy
    }
    states = dict(anycast.state_definition)
    mine = anycast.initial_policy.get(me, ROBOT)
    if anycast.params:
        own = states.get(mine) or StateConfig.model_validate({})
        states[mine] = own.model_copy(update={"params": {**anycast.params, **own.params}})
    return Policies(states, machines, initial, me, mine)


def _me(anycast: AnycastConfig, name: str) -> str:
    """Return which machine of the initial policy this gateway is: the one of its name, else the robot."""
    if name in anycast.initial_policy:
        return name
    return next((machine for machine, state in anycast.initial_policy.items() if state == ROBOT), "")


def _problems(remote: RemoteConfig, anycast: AnycastConfig, name: str, path: str) -> Iterable[Problem]:
    known = tuple(dict.fromkeys([*_PREDEFINED, *anycast.state_definition]))
    where = f"{path}.initial_policy"
    for machine, state in anycast.initial_policy.items():
        if state not in known:
            yield f"{where}.{machine}", one_of(state, known)
    me = _me(anycast, name)
    others = {machine: state for machine, state in anycast.initial_policy.items() if machine != me}
    robots = [machine for machine, state in others.items() if state == ROBOT]
    if robots:
        yield (
            f"{where}.{robots[0]}",
            f"a group has one robot, {me or 'this gateway'}; each robot has its own",
        )
    serving = [machine for machine, state in others.items() if state == SERVICE]
    if len(serving) > 1 and anycast.policy != "all":
        yield (
            f"{where}.{serving[1]}",
            f"exactly one machine is in {SERVICE}, {serving[0]}; write {STANDBY}",
        )
    if remote.address == OVERLAY:
        if anycast.machines:
            yield f"{path}.machines", "members of the overlay have names of their own; leave this out"
        yield from _crossing(remote, anycast, path)
        return
    addresses = remote.addresses
    if others and not anycast.machines and len(others) != len(addresses):
        yield (
            where,
            f"names {len(others)} machines beside the robot, and there are {len(addresses)} addresses; name the "
            f"address of each under {path}.machines",
        )
    for machine, text in anycast.machines.items():
        address = _address(text)
        if address not in addresses:
            near = did_you_mean(text, addresses)
            yield f"{path}.machines.{machine}", f"expected one of {', '.join(addresses)}, got {text}{near}"
        elif others and machine not in others:
            yield f"{path}.machines.{machine}", one_of(machine, others)
    yield from _crossing(remote, anycast, path)


def _address(text: str) -> str:
    try:
        return parse_link(text)
    except ValueError:
        return text


def _crossing(remote: RemoteConfig, anycast: AnycastConfig, path: str) -> Iterable[Problem]:
    """Check that what the robot publishes and reads in its state crosses: types stand there, and not in a policy."""
    state = anycast.state_definition.get(ROBOT)
    if state is None:
        return
    crossing = {
        "pub": {remote.names(item)[0] for item in (*remote.publish, *remote.trans_publish)},
        "sub": {remote.names(item)[0] for item in remote.subscribe},
    }
    for topic, direction in state.topics.items():
        key = {"pub": "publish", "sub": "subscribe"}[direction]
        if resolve_name(topic) not in crossing[direction]:
            near = did_you_mean(topic, crossing[direction])
            yield (
                f"{path}.state_definition.{ROBOT}.topics",
                f'{topic} does not cross; add {{"name": "{topic}", "type": "..."}} to "{key}" of this remote{near}',
            )
