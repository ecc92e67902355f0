"""Matches publishers and subscriptions by the rules of ROS 2."""

from __future__ import annotations

from ropeway.qos import QoS, unmet

__all__ = ["matches"]


def matches(offer: QoS | None, ask: QoS | None) -> bool:
    """Return whether a subscription that asks for ``ask`` may read a publisher that offers ``offer``.

    ``None`` asks for whatever is offered.
    """
    return offer is None or not unmet(offer, ask)
