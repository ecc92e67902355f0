"""Decides what a client may do: roles, rosbridge's globs, rates. One ``Access`` per client decides, counts and tells.

A role lists patterns per verb. A pattern is one of a shell (``*`` also stands for slashes, as in rosbridge's globs)
and is compared with the absolute name. What no pattern of a role names is not allowed; ``deny`` goes before ``allow``.

Two kinds of name are not what they seem. The services of rosapi are the server's own: reading is always allowed,
unless ``deny`` names it; changing parameters is a call like others. The services ``<action>/_action/…`` are an action
in parts: they need the right to the action, and no other. So do, on ROS 1, the topics ``<action>/goal`` and its kin.
"""

from __future__ import annotations

import fnmatch
import logging
import re
import time
from collections import Counter
from collections.abc import Callable, Container, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Final

from ropeway.audit.note import NO_AUDIT, AuditNote, Auditor
from ropeway.errors import AccessDenied
from ropeway.listener.globs import Globs

__all__ = ["CONTROL_RIGHTS", "EVERYTHING", "VERBS", "Access", "Globs", "Role"]

log = logging.getLogger("ropeway.server")

VERBS: Final = (
    "publish",
    "subscribe",
    "call_service",
    "advertise_service",
    "send_action_goal",
    "advertise_action",
)
"""The things that a client may want to do with a topic, a service or an action."""

CONTROL_RIGHTS: Final = frozenset(("observe", "configure", "operate"))
"""The rights at the control API: see it, change its configuration, and act on it (end a session)."""

_QUIET_S: Final = 60.0
_KNOWN_LIMIT: Final = 1024  # decisions that are remembered per client
_GLOB_OF: Final[Mapping[str, tuple[str, str]]] = {
    "publish": ("topics_pub", "topics_pub_glob"),
    "subscribe": ("topics_sub", "topics_sub_glob"),
    "call_service": ("services", "services_glob"),
    "advertise_service": ("services", "services_glob"),
    "send_action_goal": ("actions", "actions_glob"),
    "advertise_action": ("actions", "actions_glob"),
}
_CHANGES: Final = ("/rosapi/set_param", "/rosapi/delete_param")
_VERBS_OF: Final[Mapping[str, tuple[str, ...]]] = {
    "topics": ("subscribe", "publish"),
    "services": ("call_service", "advertise_service"),
    "actions": ("send_action_goal", "advertise_action"),
}
_PART_OF_ACTION: Final = re.compile(r"(.+)/_action/(?:send_goal|cancel_goal|get_result)")
_TOPIC_OF_ACTION: Final = re.compile(r"(.+)/_action/(?:feedback|status)")
_TOPIC_OF_ROS1_ACTION: Final = re.compile(r"(.+)/(goal|cancel|feedback|status|result)")


@dataclass(frozen=True)
class Role:
    """The rights of a role's clients. ``allow`` and ``deny`` have patterns by verb; limits are ``None`` for no limit.

    ``messages_per_s`` and ``bytes_per_s`` bound what a client sends, on average over a second;
    ``max_message_bytes`` one message, and ``max_clients`` how many clients have the role at a time. ``control`` are
    the rights at the control API. ``audited`` are patterns of names whose commands go to the audit log.
    """

    name: str
    allow: Mapping[str, tuple[str, ...]]
    deny: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
    messages_per_s: float | None = None
    bytes_per_s: float | None = None
    max_message_bytes: int | None = None
    max_clients: int | None = None
    control: frozenset[str] = frozenset()
    audited: tuple[str, ...] = ()

    def rule_against(self, verb: str, name: str, *, own: bool = False) -> str:
        """Return what of this role forbids it, ``""`` where nothing does; ``own`` is a service of our rosapi."""
        denied = self.denies(verb, name)
        if denied:
            return denied
        if own and not name.endswith(_CHANGES):
            return ""
        if self._allowed[verb].fullmatch(name) is None:
            return f"role {self.name} does not list it under {verb}"
        return ""

    def denies(self, verb: str, name: str) -> str:
        """Return the exception of this role that forbids it, ``""`` where there is none."""
        denied = next((p for p in self.deny.get(verb, ()) if _matches(name, (p,))), None)
        return "" if denied is None else f"role {self.name} denies {denied}"

    @cached_property
    def _allowed(self) -> Mapping[str, re.Pattern[str]]:
        return {
            verb: re.compile("|".join(fnmatch.translate(_absolute(p)) for p in self.allow.get(verb, ())) or "(?!)")
            for verb in VERBS
        }


EVERYTHING: Final = Role("all", dict.fromkeys(VERBS, ("*",)), control=CONTROL_RIGHTS)
"""The role of everybody where no authentication is asked for."""


class Access:
    """The rights of one client.

    ``client`` names it in the log; ``tally`` counts denials of all clients by rule. ``denied`` counts those of this
    one. ``limited`` is false where ``spend`` has nothing to watch. ``is_own`` tells the services of our rosapi from
    those of nodes. ``ros1_actions`` gives the actions of a ROS 1 network, where their parts are ordinary topics.
    ``audit`` is told of denials, and of commands where the role says so.
    """

    def __init__(
        self,
        role: Role = EVERYTHING,
        globs: Globs | None = None,
        *,
        client: str = "",
        tally: Counter[str] | None = None,
        clock: Callable[[], float] = time.monotonic,
        is_own: Callable[[str], bool] | None = None,
        ros1_actions: Callable[[], Container[str]] | None = None,
        audit: Auditor = NO_AUDIT,
    ) -> None:
        self._is_own, self._ros1_actions = is_own or _nobody, ros1_actions
        self.role, self.globs, self.client = role, globs or Globs(), client
        self.denied: Counter[str] = Counter()
        self.limited = role.messages_per_s is not None or role.bytes_per_s is not None
        self._tally, self._audit = tally, audit
        self._clock = clock
        self._known: dict[tuple[str, str], str] = {}
        self._said: dict[str, float] = {}  # by rule: when the log told of it
        self._unsaid: Counter[str] = Counter()
        self._messages = _Bucket(role.messages_per_s, clock())
        self._bytes = _Bucket(role.bytes_per_s, clock())

    def check(self, verb: str, name: str) -> None:
        """Check that the client may do this with ``name``; a denial is counted and logged, and raises
        ``AccessDenied``.
        """
        rule = self._known.get((verb, name)) if self._ros1_actions is None else None
        if rule is None:
            rule = self._rule_against(verb, name)
        if rule:
            raise self._refused(verb, name, rule)

    def allows(self, verb: str, name: str) -> bool:
        """Return whether the client may do this, without counting it."""
        return not self._rule_against(verb, name)

    @property
    def unrestricted(self) -> bool:
        """Return whether the client may do everything."""
        return replace(self.role, audited=()) == EVERYTHING and self.globs == Globs()

    def command(self, verb: str, name: str, payload: bytes | None = None) -> None:
        """Tell the audit log of a command, where the role says so."""
        if self._audits(name):
            self._tell_command(verb, name, payload)

    def witness(self, verb: str, name: str) -> Callable[[bytes, str], None] | None:
        """Return what tells the audit log of each command to ``name``, where the role says so."""
        if not self._audits(name):
            return None
        return lambda payload, _: self._tell_command(verb, name, payload)

    def _audits(self, name: str) -> bool:
        return bool(self.role.audited) and _matches(_absolute(name), self.role.audited)

    def _tell_command(self, verb: str, name: str, payload: bytes | None) -> None:
        self._audit.note(AuditNote("command", verb, name, f"role {self.role.name}", self.client, payload=payload))

    def sees(self, kind: str, name: str) -> bool:
        """Return whether the client may do anything with a topic, service or action (``kind`` in plural)."""
        return any(self.allows(verb, name) for verb in _VERBS_OF[kind])

    def spend(self, verb: str, name: str, size_bytes: int) -> None:
        """Count a message towards the rates of the role. Raises ``AccessDenied`` for one too many."""
        now, role = self._clock(), self.role
        if not self._messages.take(1.0, now):
            raise self._refused(verb, name, f"role {role.name} has {role.messages_per_s:g} messages per second at most")
        if not self._bytes.take(float(size_bytes), now):
            raise self._refused(verb, name, f"role {role.name} has {role.bytes_per_s:g} bytes per second at most")

    def _rule_against(self, verb: str, name: str) -> str:
        key = (verb, name)
        if self._ros1_actions is not None and (part := _TOPIC_OF_ROS1_ACTION.fullmatch(name)):
            against = self._against_part(verb, _absolute(part[1]), part[2])
            if against:  # not remembered: actions come and go
                return against
        rule = self._known.get(key)
        if rule is None:
            if len(self._known) >= _KNOWN_LIMIT:
                self._known.clear()
            rule = self._known[key] = self._decide(*_meant(verb, _absolute(name)))
        return rule

    def _against_part(self, verb: str, action: str, part: str) -> str:
        """Return what forbids a topic of a ROS 1 network that is, or may become, a part of an action."""
        assert self._ros1_actions is not None
        use = "send_action_goal" if part in ("goal", "cancel") else "advertise_action"
        if verb == "publish":
            there = action in self._ros1_actions()
            return self.role.rule_against(use, action) if there else self.role.denies(use, action)
        return self.role.denies("send_action_goal", action) if verb == "subscribe" else ""

    def _decide(self, verb: str, name: str) -> str:
        attribute, glob = _GLOB_OF[verb]
        patterns = getattr(self.globs, attribute)
        own = verb == "call_service" and self._is_own(name)
        if verb == "subscribe" and (part := _TOPIC_OF_ACTION.fullmatch(name)):
            denied = self.role.denies("send_action_goal", part[1])
            if denied:
                return denied
        if patterns is not None and not own and not _matches(name, patterns, literal=True):
            return glob
        return self.role.rule_against(verb, name, own=own)

    def _refused(self, verb: str, name: str, rule: str) -> AccessDenied:
        error = AccessDenied(verb, name[:200], rule)
        self.denied[rule] += 1
        self._audit.note(
            AuditNote("denied", verb, name, f"role {self.role.name}", self.client, outcome="refused", why=rule)
        )
        if self._tally is not None:
            self._tally[rule] += 1
        now = self._clock()
        if now - self._said.get(rule, float("-inf")) < _QUIET_S:
            self._unsaid[rule] += 1
        else:
            self._said[rule] = now
            unsaid = self._unsaid.pop(rule, 0)
            more = f" ({unsaid} more since the last such line)" if unsaid else ""
            log.warning("%s (role %s): denied: %s%s", self.client, self.role.name, error, more)
        return error


class _Bucket:
    """A rate, kept on average over a second; what is too big for a second goes once the bucket is full."""

    def __init__(self, rate: float | None, now: float) -> None:
        self._rate = rate
        self._most = max(rate or 0.0, 1.0)
        self._left, self._at = self._most, now

    def take(self, amount: float, now: float) -> bool:
        if self._rate is None:
            return True
        self._left = min(self._most, self._left + (now - self._at) * self._rate)
        self._at = now
        if self._left < min(amount, self._most):
            return False
        self._left -= amount
        return True


def _meant(verb: str, name: str) -> tuple[str, str]:
    """Return the verb and the name that decide: parts of an action stand for the action."""
    if verb in ("call_service", "advertise_service") and (part := _PART_OF_ACTION.fullmatch(name)):
        return ("send_action_goal" if verb == "call_service" else "advertise_action"), part[1]
    if verb == "publish" and (part := _TOPIC_OF_ACTION.fullmatch(name)):
        return "advertise_action", part[1]
    return verb, name


def _nobody(name: str) -> bool:
    return False


def _absolute(name: str) -> str:
    return name if name.startswith(("/", "*", "?", "[")) else f"/{name}"


def _matches(name: str, patterns: Iterable[str], *, literal: bool = False) -> bool:
    """Return whether a pattern matches; ``literal`` ones may also match the name as a client writes it, without the
    slash.
    """
    if literal:
        return any(fnmatch.fnmatchcase(name, p) or fnmatch.fnmatchcase(name[1:], p) for p in patterns)
    return any(fnmatch.fnmatchcase(name, _absolute(p)) for p in patterns)
