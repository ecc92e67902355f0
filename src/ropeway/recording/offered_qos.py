"""Writes and reads the QoS of recorded topics as rosbag2 keeps it: a list of profiles, as YAML."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any, Final

import yaml

from ropeway.qos import DEFAULT, LATCHED, QoS, common_qos

__all__ = ["PROFILES_KEY", "profiles_in", "profiles_text", "recorded_qos"]

PROFILES_KEY: Final = "offered_qos_profiles"
"""The name under which a channel of MCAP and a topic of SQLite have the text."""

_FOREVER: Final = {"sec": 9_223_372_036, "nsec": 854_775_807}
_FOREVER_S: Final = 2.0**31


def profiles_text(offered: Iterable[QoS]) -> str:
    """Return the profiles of a topic's publishers as rosbag2 writes them, ``""`` where there are none."""
    profiles = [_profile(qos) for qos in offered]
    return yaml.safe_dump(profiles, sort_keys=False) if profiles else ""


def profiles_in(text: Any) -> list[dict[str, Any]]:
    """Return the QoS profiles that a recording states, as YAML or already parsed; empty if they cannot be read."""
    try:
        found = yaml.safe_load(text) if isinstance(text, str) else text
    except (yaml.YAMLError, ValueError, RecursionError):
        return []
    return [profile for profile in found if isinstance(profile, dict)] if isinstance(found, list) else []


def recorded_qos(topic: str, profiles: Iterable[dict[str, Any]], *, latched: bool = False) -> QoS:
    """Return what the publishers of a recorded topic offered."""
    if latched or topic.rpartition("/")[2] == "tf_static":
        return LATCHED
    return common_qos(
        QoS(
            reliability=_policy(profile.get("reliability"), ("reliable", "best_effort"), "reliable"),
            durability=_policy(profile.get("durability"), ("transient_local", "volatile"), "volatile"),
            history=_policy(profile.get("history"), ("keep_last", "keep_all"), "keep_last"),
            depth=depth if isinstance(depth := profile.get("depth"), int) and 0 < depth < 10_000 else DEFAULT.depth,
        )
        for profile in profiles
    )


def _profile(qos: QoS) -> dict[str, object]:
    return {
        "history": qos.history,
        "depth": qos.depth,
        "reliability": "reliable" if qos.reliable else "best_effort",
        "durability": "transient_local" if qos.transient_local else "volatile",
        "deadline": _duration(qos.deadline_s),
        "lifespan": _duration(qos.lifespan_s),
        "liveliness": "automatic",
        "liveliness_lease_duration": dict(_FOREVER),
        "avoid_ros_namespace_conventions": False,
    }


def _duration(seconds: float | None) -> dict[str, int]:
    if seconds is None or seconds >= _FOREVER_S:
        return dict(_FOREVER)
    sec, nsec = divmod(round(seconds * 1e9), 1_000_000_000)
    return {"sec": sec, "nsec": nsec}


def _policy(value: Any, choices: tuple[str, ...], default: str) -> str:
    """Return a policy from its number in ``rmw`` or its name."""
    if isinstance(value, int):
        return choices[value - 1] if 1 <= value <= len(choices) else default
    return str(value).lower() if str(value).lower() in choices else default
