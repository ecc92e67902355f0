"""QoS profiles as rclpy has them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any, Final

from ropeway.qos import QoS

__all__ = ["from_rclpy", "reader_profile", "service_profile", "writer_profile"]

# History of a reader that asks for transient local: what several publishers kept arrives in one burst.
_REPLAY_DEPTH: Final = 256
# History of a reader that asks for all: the thread that empties it applies the bound in bytes.
_KEEP_ALL_DEPTH: Final = 1000
# Requests and responses that may wait for the thread that takes them; rclpy's own ten are few for many calls at once.
_SERVICE_DEPTH: Final = 256
_FOREVER_NS: Final = 2**62


def writer_profile(qos: QoS) -> Any:
    """Return the ``QoSProfile`` of a publisher."""
    return _profile(qos)


def reader_profile(qos: QoS) -> Any:
    """Return the ``QoSProfile`` of a subscription, which keeps a bounded number of messages."""
    depth = max(qos.depth, 1)
    if qos.history == "keep_all":
        depth = _KEEP_ALL_DEPTH
    elif qos.transient_local:
        depth = max(depth, _REPLAY_DEPTH)
    return _profile(replace(qos, history="keep_last", depth=depth, lifespan_s=None))


def service_profile() -> Any:
    """Return the ``QoSProfile`` of a client or service."""
    return _profile(QoS(depth=_SERVICE_DEPTH))


def from_rclpy(profile: Any) -> QoS:
    """Return what a discovered endpoint offers or asks for; the depth is 0 if the middleware does not tell it."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, ReliabilityPolicy

    keep_all = profile.history == HistoryPolicy.KEEP_ALL
    told = keep_all or profile.history == HistoryPolicy.KEEP_LAST
    return QoS(
        reliability="best_effort" if profile.reliability == ReliabilityPolicy.BEST_EFFORT else "reliable",
        durability="transient_local" if profile.durability == DurabilityPolicy.TRANSIENT_LOCAL else "volatile",
        history="keep_all" if keep_all else "keep_last",
        depth=int(profile.depth) if told else 0,
        deadline_s=_seconds(profile.deadline),
        lifespan_s=_seconds(profile.lifespan),
    )


def _profile(qos: QoS) -> Any:
    from rclpy.duration import Duration
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    more: dict[str, Any] = {}
    for key, seconds in (("deadline", qos.deadline_s), ("lifespan", qos.lifespan_s)):
        if seconds is not None:
            more[key] = Duration(nanoseconds=min(max(round(seconds * 1e9), 1), _FOREVER_NS))
    return QoSProfile(
        history=HistoryPolicy.KEEP_ALL if qos.history == "keep_all" else HistoryPolicy.KEEP_LAST,
        depth=max(qos.depth, 1),
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE,
        **more,
    )


def _seconds(duration: Any) -> float | None:
    nanoseconds = int(duration.nanoseconds)
    return None if nanoseconds <= 0 or nanoseconds >= _FOREVER_NS else nanoseconds / 1e9
