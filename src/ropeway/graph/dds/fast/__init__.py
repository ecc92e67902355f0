"""Services of Fast DDS nodes, which correlate requests and replies by what the Cyclone DDS library does not show."""

from ropeway.graph.dds.fast.rpc import FastClient, FastRpc, FastService

__all__ = ["FastClient", "FastRpc", "FastService"]
