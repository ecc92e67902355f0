"""Services of Fast DDS nodes, which correlate requests and replies by what the Cyclone DDS library does not show."""

from ropeway.networks.dds.fastdds.helper import FastHelper
from ropeway.networks.dds.fastdds.identity import FAST
from ropeway.networks.dds.fastdds.rpc import FastClient, FastRpc, FastService, Surroundings

__all__ = ["FAST", "FastClient", "FastHelper", "FastRpc", "FastService", "Surroundings"]
