"""Topics that we read from DDS."""

from __future__ import annotations

from ropeway.graph import following
from ropeway.graph.dds.endpoints import RawReader
from ropeway.graph.following import settled

__all__ = ["DdsSubscription", "SharedReader", "settled"]

SharedReader = following.SharedReader[RawReader]
DdsSubscription = following.Following[RawReader]
