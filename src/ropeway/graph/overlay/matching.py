"""Which publishers and subscriptions go together: the rules of ROS 2."""

from __future__ import annotations

from ropeway.qos import QoS

__all__ = ["matches"]


def matches(offer: QoS | None, ask: QoS | None) -> bool:
    """True where a subscription that asks for ``ask`` may read a publisher that offers ``offer``.

    ``None`` asks for whatever is offered.
    """
    if offer is None or ask is None:
        return True
    return (offer.reliable or not ask.reliable or ask.reliability == "best_available") and (
        offer.transient_local or not ask.transient_local
    )
