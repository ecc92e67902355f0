"""Connections to the providers of services, and what they tell of their type."""

from __future__ import annotations

import asyncio
import logging
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from ropeway import aio
from ropeway.errors import InvalidFrame
from ropeway.networks.ros1.tcpros import encode_header, read_header
from ropeway.types.ros1_types import ANY

if TYPE_CHECKING:
    from ropeway.networks.ros1.node import Ros1Node

__all__ = ["Stream", "connect", "probe_service"]

log = logging.getLogger("ropeway.ros1")

_PROBE_S: Final = 3.0

Stream = tuple[asyncio.StreamReader, asyncio.StreamWriter]


async def connect(api: str) -> Stream:
    """Connect to ``rosrpc://host:port``. Raises ``OSError`` and ``ValueError``."""
    parts = urlsplit(api)
    if parts.scheme != "rosrpc" or not parts.hostname or not parts.port:
        raise ValueError(f"{api!r} is not rosrpc://host:port")
    return await asyncio.open_connection(parts.hostname, parts.port)


async def probe_service(node: Ros1Node, service: str, api: str) -> str:
    """Return the type of a service, ``pkg/Name``, from the header its provider answers; ``""`` if it gives none."""
    try:
        async with aio.timeout(_PROBE_S):
            reader, writer = await connect(api)
            try:
                fields = {"callerid": node.name, "md5sum": ANY, "probe": "1", "service": service}
                writer.write(encode_header(fields))
                return (await read_header(reader)).get("type", "")
            finally:
                writer.close()
    except (OSError, EOFError, ValueError, TimeoutError, InvalidFrame) as error:
        log.debug("%s: the type of %s is not known: %s", node.graph.name, service, error)
        return ""
