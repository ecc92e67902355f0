"""Services of Fast DDS nodes, which correlate requests and replies by what the Cyclone DDS library does not show."""

from ropeway.graph.dds.fast.helper import FastHelper
from ropeway.graph.dds.fast.identity import FAST
from ropeway.graph.dds.fast.rpc import FastClient, FastRpc, FastService, Surroundings

__all__ = ["FAST", "FastClient", "FastHelper", "FastRpc", "FastService", "Surroundings"]
