"""The options of a route as a configuration has them: compared as a whole, and told apart one by one."""

from __future__ import annotations

from dataclasses import asdict, dataclass, fields, is_dataclass
from typing import Any

from ropeway.graph.base import NO_HINTS, Delivery
from ropeway.qos import QoS
from ropeway.types.frame_names import FrameNames

__all__ = ["AS_IT_COMES", "RouteOptions"]


@dataclass(frozen=True, slots=True)
class RouteOptions:
    """Says how a route treats what crosses it. Where an option differs, the route is changed, and stays what it is."""

    delivery: Delivery = NO_HINTS
    qos: QoS | None = None
    timeout_s: float | None = None  # of a call or a goal
    store: bool = False  # the last message is kept
    frames: FrameNames | None = None  # how coordinate frames are called on the other side
    audit: bool = False  # what crosses is written down

    def to_json(self) -> dict[str, Any]:
        """Return all options by name, those of the delivery beside the others."""
        found = {name: getattr(self.delivery, name) for name in self.delivery.__slots__}
        for field in fields(self):
            if field.name != "delivery":
                found[field.name] = _plain(getattr(self, field.name))
        return found


AS_IT_COMES = RouteOptions()
"""The options of a route of which nobody says anything."""


def _plain(value: Any) -> Any:
    if isinstance(value, QoS):
        return value.to_json()
    return asdict(value) if is_dataclass(value) and not isinstance(value, type) else value
