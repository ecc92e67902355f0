"""Says how a bridge treats what crosses it: one object from the gateway to the bridge, whatever options there are."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ropeway.graph.base import NO_HINTS, Delivery
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.delivery.passage import Keep
    from ropeway.delivery.pipeline import Step, Tap, Witness

__all__ = ["AS_IT_COMES", "BridgeOptions"]


@dataclass(frozen=True, slots=True)
class BridgeOptions:
    """The options of a bridge; those that its kind does not know are ignored.

    ``delivery`` says how the link between the two sides treats the name; it goes to whichever side is a link.
    ``qos=None`` adopts what the source's publishers offer and follows it. The pipeline's limits are applied on the near
    side of the link only (``limit``), so that nothing crosses that will be dropped. With ``keep`` the last message is
    kept, and late joiners on the target get it, whether the source has it latched or not; ``frames`` renames the
    coordinate frames of what passes, ``witness`` is told of it, and ``tap`` gets what has really crossed. A call or a
    goal may take ``timeout_s``.
    """

    delivery: Delivery = NO_HINTS
    qos: QoS | None = None
    limit: bool = True
    timeout_s: float | None = None
    keep: Keep | None = None
    frames: Step | None = None
    witness: Witness | None = None
    tap: Tap | None = None


AS_IT_COMES = BridgeOptions()
"""The options of a bridge of which nobody says anything."""
