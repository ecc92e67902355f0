"""Quality of service, with the keys and values of rosbridge's ``qos`` object.

A profile that says nothing about a policy leaves the choice to the graph (``None``). Profiles are immutable;
``QoS.parse`` reads the JSON form, ``QoS.to_json`` writes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from typing import Any, Final

from ropeway.limits import QOS_DEPTH_SAMPLES

__all__ = ["DEFAULT", "LATCHED", "PROFILES", "SENSOR_DATA", "QoS", "adopted", "common_qos", "settled", "unmet"]

_CHOICES: Final = {
    "history": ("keep_last", "keep_all"),
    "reliability": ("reliable", "best_effort", "best_available"),
    "durability": ("volatile", "transient_local", "best_available"),
}


_DEEPEST: Final = 2**31 - 1  # what DDS can say
_FOREVER_S: Final = 2.0**31


@dataclass(frozen=True, slots=True)
class QoS:
    """A quality-of-service profile.

    ``depth`` counts samples (used with ``keep_last``); 0 stands for a depth that was not told, as of Fast DDS
    publishers; it is ``QOS_DEPTH_SAMPLES`` at most, whoever asks for more: a client, a writer on the network, a remote.
    ``deadline_s`` and ``lifespan_s`` are seconds, ``None`` meaning infinite.
    """

    reliability: str = "reliable"
    durability: str = "volatile"
    history: str = "keep_last"
    depth: int = 10
    deadline_s: float | None = None
    lifespan_s: float | None = None

    def __post_init__(self) -> None:
        if self.depth > QOS_DEPTH_SAMPLES:  # here, so that no profile exists that would ask a writer for more
            object.__setattr__(self, "depth", QOS_DEPTH_SAMPLES)

    @property
    def reliable(self) -> bool:
        """Whether delivery is reliable: always, unless the profile is best effort."""
        return self.reliability != "best_effort"

    @property
    def transient_local(self) -> bool:
        """Whether late joiners get what was published before."""
        return self.durability == "transient_local"

    @property
    def latched(self) -> bool:
        """Whether late joiners get earlier messages however late they are."""
        return self.transient_local and self.lifespan_s is None

    @property
    def adopts(self) -> bool:
        """Whether a policy asks for the best there is."""
        return "best_available" in (self.reliability, self.durability)

    def satisfies(self, ask: QoS | None) -> bool:
        """Return whether a reader that asks for ``ask``, ``None`` for anything, matches a writer that offers this."""
        return not unmet(self, ask)

    @classmethod
    def parse(cls, value: Mapping[str, Any], base: QoS | None = None) -> QoS:
        """Read a rosbridge ``qos`` object; what it leaves out is taken from ``base``.

        Raises ``ValueError`` with a sentence that names the policy and its valid values.
        """
        if not isinstance(value, Mapping):
            raise ValueError('qos must be an object, as in {"reliability": "best_effort"}')
        unknown = set(value) - {"history", "depth", "reliability", "durability", "deadline", "lifespan"}
        if unknown:
            raise ValueError(f"unknown qos policy {min(map(str, unknown))!r}")
        changes: dict[str, Any] = {}
        for key, valid in _CHOICES.items():
            if key in value:
                given = value[key]
                if not isinstance(given, str) or given.lower() not in valid:
                    raise ValueError(f"{given!r} is not a valid {key}. Valid options are: {', '.join(valid)}")
                changes[key] = given.lower()
        if "depth" in value:
            depth = value["depth"]
            if isinstance(depth, bool) or not isinstance(depth, int) or not 0 <= depth <= _DEEPEST:
                raise ValueError(f"{depth!r} is not a valid depth. Valid are whole numbers from 0 to {_DEEPEST}")
            changes["depth"] = depth
        for key in ("deadline", "lifespan"):
            if key in value:
                changes[f"{key}_s"] = _duration(key, value[key])
        return replace(base or cls(), **changes)

    def to_json(self) -> dict[str, Any]:
        """Return the rosbridge form; infinite durations are left out."""
        out: dict[str, Any] = {
            "history": self.history,
            "depth": self.depth,
            "reliability": self.reliability,
            "durability": self.durability,
        }
        if self.deadline_s is not None:
            out["deadline"] = self.deadline_s
        if self.lifespan_s is not None:
            out["lifespan"] = self.lifespan_s
        return out


def _duration(key: str, value: object) -> float | None:
    if value in ("infinite", "best_available", None):
        return None
    parts = (
        [value["secs"], value["nsecs"]] if isinstance(value, Mapping) and {"secs", "nsecs"} <= set(value) else [value]
    )
    seconds = 0.0
    for part, unit in zip(parts, (1, 1e9), strict=False):
        if isinstance(part, bool) or not isinstance(part, (int, float)):
            raise ValueError(f'{key} must be seconds, {{"secs", "nsecs"}} or "infinite"')
        if not part >= 0:
            raise ValueError(f"{key} must not be negative")
        seconds += min(part, _FOREVER_S * unit) / unit
    return None if seconds >= _FOREVER_S else seconds


DEFAULT: Final = QoS()
SENSOR_DATA: Final = QoS(reliability="best_effort", depth=5)
LATCHED: Final = QoS(durability="transient_local", depth=1)

PROFILES: Final[Mapping[str, QoS]] = {
    "default": DEFAULT,
    "system_default": QoS(depth=1),
    "sensor_data": SENSOR_DATA,
    "services_default": DEFAULT,
    "parameters": QoS(depth=1000),
    "parameter_events": QoS(depth=1000),
    "action_status_default": LATCHED,
    "best_available": QoS(reliability="best_available", durability="best_available"),
    "latched": LATCHED,
}
"""The profiles of ROS 2 by name, and ``latched``."""


def unmet(offer: QoS, ask: QoS | None) -> tuple[str, ...]:
    """Return the policies that keep a reader that asks for ``ask`` from matching a writer that offers ``offer``.

    ``None`` asks for whatever is offered.
    """
    if ask is None:
        return ()
    found = []
    if not offer.reliable and ask.reliability == "reliable":
        found.append("reliability")
    if ask.durability == "transient_local" and not offer.transient_local:
        found.append("durability")
    if ask.deadline_s is not None and (offer.deadline_s is None or offer.deadline_s > ask.deadline_s):
        found.append("deadline")
    return tuple(found)


def common_qos(offered: Iterable[QoS], fallback: QoS = DEFAULT) -> QoS:
    """Return the strongest request that every one of ``offered`` satisfies.

    A reader that asks for this matches all of these writers: reliable only if all are, transient local only if
    all are. It is as deep as the deepest; where all are transient local as all of them together, so that what
    several publishers latch (``/tf_static``) has room, and has their lifespan if all have one. Nothing offered gives
    ``fallback``.
    """
    profiles = list(offered)
    if not profiles:
        return fallback
    transient_local = all(q.transient_local for q in profiles)
    depths = [q.depth or DEFAULT.depth for q in profiles]
    lifespans = [q.lifespan_s for q in profiles if q.lifespan_s is not None]
    expires = transient_local and len(lifespans) == len(profiles)
    return QoS(
        reliability="reliable" if all(q.reliable for q in profiles) else "best_effort",
        durability="transient_local" if transient_local else "volatile",
        history="keep_all" if any(q.history == "keep_all" for q in profiles) else "keep_last",
        depth=sum(depths) if transient_local else max(depths),
        lifespan_s=max(lifespans) if expires else None,
    )


def settled(asked: QoS, offered: QoS) -> QoS:
    """Return ``asked`` with every ``best_available`` policy replaced by that of ``offered``."""
    return replace(
        asked,
        reliability=offered.reliability if asked.reliability == "best_available" else asked.reliability,
        durability=offered.durability if asked.durability == "best_available" else asked.durability,
    )


def adopted(asked: QoS | None, offered: Iterable[QoS], current: QoS = DEFAULT) -> QoS:
    """Return the profile of a reader that asks for ``asked``, where writers offer these.

    ``None`` adopts what all of them satisfy, a profile with ``best_available`` policies these alone; ``current`` stays
    where nothing is offered.
    """
    if asked is None:
        return common_qos(offered, current)
    return settled(asked, common_qos(offered, current)) if asked.adopts else asked
