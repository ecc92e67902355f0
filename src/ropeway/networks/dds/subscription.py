"""Topics that we read from DDS."""

from __future__ import annotations

from ropeway.graph import qos_adoption as following
from ropeway.graph.qos_adoption import settled
from ropeway.networks.dds.raw_endpoints import RawReader

__all__ = ["DdsSubscription", "SharedReader", "settled"]

SharedReader = following.SharedReader[RawReader]
DdsSubscription = following.AdoptingSubscription[RawReader]
