"""Models what to expect of links and topics, for predictions."""

from __future__ import annotations

from pydantic import Field

from ropeway.gateway.config.fields import Model
from ropeway.gateway.config.route_fields import Seconds

__all__ = ["ExpectedLink", "ExpectedTraffic"]


class ExpectedTraffic(Model):
    """Says what to expect of a topic, for predictions; nothing that runs depends on it."""

    bytes: float = Field(gt=0, allow_inf_nan=False, description="mean size of a message")
    hz: Seconds = Field(description="messages per second of each publisher")
    publishers: int = Field(1, ge=1, le=10_000, description="how many publish it on the side that it comes from")
    readers: int = Field(1, ge=1, le=10_000, description="how many read it on the other side")
    ratio: float | None = Field(
        None, gt=0, allow_inf_nan=False, description="bytes of a message over those that travel; default: 1"
    )


class ExpectedLink(Model):
    """Says what to expect of the link to a remote, for predictions; nothing that runs depends on it."""

    mbit: Seconds = Field(description="what it carries each way, in Mbit/s")
    delay_ms: float = Field(0.0, ge=0, allow_inf_nan=False, description="its delay one way")
    duplex: bool = Field(True, description="false: both ways share the rate, as on Wi-Fi")
