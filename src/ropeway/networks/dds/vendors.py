"""Tells which far endpoints use our mapping of requests and replies, and who helps with the others.

ROS 2 has one mapping per middleware: rmw_cyclonedds puts a header in front of each request and reply (``rpc``),
rmw_fastrtps and rmw_connextdds correlate by inline QoS, which the library does not show. Topics are the same for all,
so both kinds are discovered and matched alike; what a GUID begins with tells them apart.
"""

from __future__ import annotations

from typing import Final, Protocol

from ropeway.graph.calls import Client, Service, ServiceHandler

__all__ = ["HEADER_VENDOR", "HELPER_MARK", "VendorHelper", "speaks_header", "vendor_name"]

HELPER_MARK: Final = "helper"
"""The USER_DATA key of endpoints that a ``VendorHelper`` makes: they are neither listed, called nor answered."""

HEADER_VENDOR: Final = b"\x01\x10"
"""The first bytes of GUIDs of Cyclone DDS, whose requests and replies begin with our header."""

_NAMES: Final = {HEADER_VENDOR: "Cyclone DDS", b"\x01\x0f": "Fast DDS", b"\x01\x01": "RTI Connext"}


def speaks_header(guid: bytes) -> bool:
    """Return whether the requests and replies of an endpoint begin with our header."""
    return guid.startswith(HEADER_VENDOR)


def vendor_name(guid: bytes) -> str:
    """Return the name of an endpoint's middleware for a message to people."""
    return _NAMES.get(guid[:2], f"DDS vendor {guid[:2].hex('.')}")


class VendorHelper(Protocol):
    """Calls and serves nodes of a middleware with another mapping, such as Fast DDS; ``DdsGraph.helper`` is one.

    Its endpoints and participants carry ``HELPER_MARK`` in their USER_DATA (``helper=1;``). A ``DdsClient`` hands it
    the calls for which only such servers are matched; a ``DdsService`` has it serve the same name for such clients,
    through a handler that raises no ``CallError``: what failed is answered with the default response there, too.
    """

    def wake(self) -> None:
        """Prepare for a call: a node with that mapping serves what we may call soon."""

    async def create_client(self, service: str, type: str) -> Client:
        """Create a client; ``service`` and ``type`` are full names. Made at the first call that needs it."""

    async def create_service(self, service: str, type: str, handler: ServiceHandler) -> Service:
        """Create a service; done together with each ``DdsService``."""
