"""Plans a change of configuration: what would start, stop and change, and what each step interrupts.

Remotes and routes are told apart by what makes them what they are, not by their place in the file: an insertion
moves nobody else.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Final, Literal

from ropeway.errors import ConfigError
from ropeway.gateway.config.config import Config, Route
from ropeway.gateway.config.model import RemoteConfig
from ropeway.gateway.config.route_model import OPERATIONS
from ropeway.gateway.config.safety_model import SafetyItem
from ropeway.listener.http import without_token

__all__ = ["ConfigPlan", "PlanStep", "RemotePlan", "make_plan", "remote_keys"]

_LIVE: Final = frozenset(("audit", "auth", "globs", "record", "tls", "types", "insecure"))
"""The keys of the gateway that are changed while everything goes on."""

_NEXT_START: Final = frozenset(("control",))
"""Keys that count from the next start on: whoever changes them would saw off the branch."""

_ITEMS: Final = frozenset(operation.replace("-", "_") for operation in OPERATIONS)
_UNSHARED: Final = _ITEMS | {"title", "active", "link"}
"""Keys of a remote that its link does not depend on."""
_SHOWN: Final = 200  # characters of a value in a plan


@dataclass(frozen=True, slots=True)
class PlanStep:
    """A step that a person reads: what happens to a route, a remote or the gateway."""

    action: Literal["start", "stop", "change", "replace", "restart", "note"]
    what: Literal["route", "remote", "gateway"]
    name: str
    path: str
    details: tuple[str, ...] = ()
    interrupts: str = ""

    def to_json(self) -> dict[str, Any]:
        """Return the step as JSON."""
        return {
            "action": self.action,
            "what": self.what,
            "name": self.name,
            "path": self.path,
            "details": list(self.details),
            "interrupts": self.interrupts,
        }


@dataclass(frozen=True, slots=True)
class RemotePlan:
    """The part of a plan for a remote that is to run: ``before`` is its index in the old configuration, if it stays.

    ``replaces`` is the index of one that it takes the place of.
    """

    index: int
    before: int | None = None
    replaces: int | None = None
    added: tuple[Route, ...] = ()
    removed: tuple[Route, ...] = ()
    changed: tuple[tuple[Route, Route], ...] = ()
    unchanged: int = 0
    routes: tuple[Route, ...] = ()  # all of them, in order


@dataclass(frozen=True, slots=True)
class ConfigPlan:
    """The way from one configuration to another. ``restart`` names what cannot be changed while everything goes on."""

    old: Config
    new: Config
    steps: tuple[PlanStep, ...]
    remotes: tuple[RemotePlan, ...] = ()
    stopped: tuple[int, ...] = ()  # indexes of old remotes that end, replaced ones too
    restart: tuple[str, ...] = ()
    live: frozenset[str] = field(default_factory=frozenset)
    unchanged: int = 0

    @property
    def empty(self) -> bool:
        """Whether nothing would happen."""
        return not self.steps

    def to_json(self) -> dict[str, Any]:
        """Return the plan for people and programs."""
        return {
            "from": self.old.etag,
            "to": self.new.etag,
            "steps": [step.to_json() for step in self.steps],
            "unchanged_routes": self.unchanged,
            "restart": list(self.restart),
        }


def remote_keys(config: Config) -> list[str]:
    """Return what tells each remote from the others: all that its link is made of; equal ones get a number."""
    counts: dict[str, int] = {}
    keys = []
    for remote in config.remotes:
        text = remote.model_dump_json(by_alias=True, exclude=set(_UNSHARED), exclude_none=True)
        number = counts[text] = counts.get(text, 0) + 1
        keys.append(f"{text}#{number}")
    return keys


def make_plan(old: Config, new: Config) -> ConfigPlan:
    """Compare two configurations. Raises ``ConfigError`` for what only a new process can do."""
    if (old.gateway.workers == 0) != (new.gateway.workers == 0):
        text = "a running gateway cannot change between one process and workers; stop it, and run the new file"
        raise ConfigError([("gateway.workers", text)])
    steps: list[PlanStep] = []
    restart, live = _gateway_steps(old, new, steps)
    before, after = _living(old), _living(new)
    pairs = _pairs(old, new, before, after)
    plans: list[RemotePlan] = []
    unchanged = 0
    for index, routes in after.items():
        stays, place = pairs[index]
        if stays:
            assert place is not None
            made = _kept(index, place, before[place], routes)
            unchanged += made.unchanged
        else:
            everything = tuple(routes.values())
            made = RemotePlan(index, replaces=place, added=everything, routes=everything)
        plans.append(made)
        _remote_steps(old, new, made, before, steps)
    staying = {plan.before for plan in plans}
    stopped = tuple(index for index in before if index not in staying)
    replaced = {plan.replaces for plan in plans}
    for index in stopped:
        if index not in replaced:
            _stop_steps(old, index, before[index], steps)
    return ConfigPlan(old, new, tuple(steps), tuple(plans), stopped, tuple(restart), live, unchanged)


def _gateway_steps(old: Config, new: Config, steps: list[PlanStep]) -> tuple[list[str], frozenset[str]]:
    """Add the steps of the gateway's own keys; return those that need a restart, and those that are changed live."""
    restart: list[str] = []
    live: set[str] = set()
    for name, info in type(new.gateway).model_fields.items():
        was, becomes = getattr(old.gateway, name), getattr(new.gateway, name)
        if was == becomes:
            continue
        key = info.alias or name
        path = f"gateway.{key}"
        if key in _LIVE:
            live.add(key)
            steps.append(PlanStep("change", "gateway", key, path, interrupts=_LIVE_INTERRUPTS.get(key, "")))
        elif key in _NEXT_START:
            steps.append(PlanStep("note", "gateway", key, path, ("counts from the next start on",)))
        else:
            restart.append(path)
            details = (f"{_shown(was)} → {_shown(becomes)}",)
            steps.append(PlanStep("restart", "gateway", key, path, details, _EVERYTHING))
    if _guards(new) != _guards(old) and "gateway.safety" not in restart:
        restart.append("gateway.safety")
        details = ("leases and limits of commands differ",)
        steps.append(PlanStep("restart", "gateway", "safety", "gateway.safety", details, _EVERYTHING))
    if new.stores != old.stores and "gateway.store" not in restart:
        restart.append("gateway.store")
        what = "last values are kept from now on" if new.stores else "nothing is kept any more"
        steps.append(PlanStep("restart", "gateway", "store", "gateway.store", (what,), _EVERYTHING))
    return restart, frozenset(live)


_EVERYTHING: Final = "all links, clients and routes, for about a second"
_LIVE_INTERRUPTS: Final[Mapping[str, str]] = {
    "audit": "clients whose commands are written down from now on, or no more",
    "auth": "clients whose credentials are no longer good",
    "record": "recordings of recorders that differ, which end and begin anew",
    "tls": "clients whose certificates are no longer good",
}


def _guards(config: Config) -> list[SafetyItem]:
    return [item for _, item in config.safeties()]


def _living(config: Config) -> dict[int, dict[str, Route]]:
    """Return the remotes that run, by index, each with its routes by key."""
    found: dict[int, dict[str, Route]] = {
        index: {} for index, remote in enumerate(config.remotes) if remote.active and remote.lasts
    }
    places = {id(remote): index for index, remote in enumerate(config.remotes)}
    for route in config.routes():
        found.setdefault(places[id(route.remote)], {})[route.key] = route
    return dict(sorted(found.items()))


def _pairs(
    old: Config, new: Config, before: Mapping[int, Mapping[str, Route]], after: Mapping[int, Mapping[str, Route]]
) -> dict[int, tuple[bool, int | None]]:
    """Return for every new remote whether an old one stays for it, and the old one that stays or is replaced."""
    old_keys, new_keys = remote_keys(old), remote_keys(new)
    by_key = {old_keys[index]: index for index in before}
    pairs: dict[int, tuple[bool, int | None]] = {}
    for index in after:
        place = by_key.get(new_keys[index])
        if place is not None:
            pairs[index] = (True, place)
    left = [index for index in before if index not in {place for _, place in pairs.values()}]
    for index in after:
        if index not in pairs:
            addresses = new.remotes[index].addresses
            place = next((i for i in left if old.remotes[i].addresses == addresses), None)
            if place is not None:
                left.remove(place)
            pairs[index] = (False, place)
    return pairs


def _kept(index: int, place: int, before: Mapping[str, Route], after: Mapping[str, Route]) -> RemotePlan:
    both = [(before[key], route) for key, route in after.items() if key in before]
    changed = tuple(pair for pair in both if pair[0].options != pair[1].options)
    return RemotePlan(
        index,
        place,
        added=tuple(route for key, route in after.items() if key not in before),
        removed=tuple(route for key, route in before.items() if key not in after),
        changed=changed,
        unchanged=len(both) - len(changed),
        routes=tuple(after.values()),
    )


def _remote_steps(
    old: Config,
    new: Config,
    plan: RemotePlan,
    before: Mapping[int, Mapping[str, Route]],
    steps: list[PlanStep],
) -> None:
    remote = new.remotes[plan.index]
    path, name = f"remotes[{plan.index}]", _address(remote)
    if plan.before is None:
        action: Literal["start", "replace"] = "start" if plan.replaces is None else "replace"
        details: Sequence[str] = ()
        interrupts = ""
        if plan.replaces is not None:
            details = _differences(old.remotes[plan.replaces], remote)
            interrupts = "calls and goals that are under way there; messages go on" if _calls(plan.added) else ""
        steps.append(PlanStep(action, "remote", name, path, tuple(details), interrupts))
    replaced = before[plan.replaces] if plan.replaces is not None else {}
    steps.extend(_route_step("start", route) for route in plan.added if route.key not in replaced)
    stays = {route.key for route in plan.added}
    steps.extend(_route_step("stop", r, _stop_interrupts(r)) for key, r in replaced.items() if key not in stays)
    for was, becomes in plan.changed:
        steps.append(_route_step("change", becomes, _change_interrupts(becomes), _route_differences(was, becomes)))
    steps.extend(_route_step("stop", route, _stop_interrupts(route)) for route in plan.removed)


def _stop_steps(old: Config, index: int, routes: Mapping[str, Route], steps: list[PlanStep]) -> None:
    steps.extend(_route_step("stop", route, _stop_interrupts(route)) for route in routes.values())
    steps.append(PlanStep("stop", "remote", _address(old.remotes[index]), f"remotes[{index}]"))


def _route_step(
    action: Literal["start", "stop", "change"], route: Route, interrupts: str = "", details: Iterable[str] = ()
) -> PlanStep:
    name = f"{route.operation} {route.name} [{route.type}]"
    return PlanStep(action, "route", name, route.path, tuple(details), interrupts)


def _stop_interrupts(route: Route) -> str:
    if route.kind == "topic":
        return f"readers of {route.name} get no more messages"
    return f"{'goals' if route.kind == 'action' else 'calls'} that are under way for more than 2 s"


def _change_interrupts(route: Route) -> str:
    return "" if route.kind == "topic" else _stop_interrupts(route)


def _calls(routes: Iterable[Route]) -> bool:
    return any(route.kind != "topic" for route in routes)


def _route_differences(was: Route, becomes: Route) -> list[str]:
    """Return the options of a route that differ, with both values."""
    return _compared(was.options.to_json(), becomes.options.to_json())


def _differences(was: RemoteConfig, becomes: RemoteConfig) -> list[str]:
    dumped = [remote.model_dump(mode="json", by_alias=False, exclude=set(_UNSHARED)) for remote in (was, becomes)]
    return _compared(*dumped)


def _compared(was: Mapping[str, Any], becomes: Mapping[str, Any]) -> list[str]:
    return [
        f"{key}: {_shown(was.get(key))} → {_shown(value)}" for key, value in becomes.items() if value != was.get(key)
    ]


def _shown(value: Any) -> str:
    text = without_token(json.dumps(value, ensure_ascii=False, default=_plain))
    return text if len(text) <= _SHOWN else f"{text[: _SHOWN - 1]}…"


def _plain(value: Any) -> Any:
    return (
        value.model_dump(mode="json", by_alias=True, exclude_none=True) if hasattr(value, "model_dump") else str(value)
    )


def _address(remote: RemoteConfig) -> str:
    return ",".join(map(without_token, remote.addresses))
