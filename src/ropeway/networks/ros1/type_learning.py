"""Asks a publisher for the definition of a type that nobody here knows."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from ropeway import aio
from ropeway.errors import ConnectFailed, InvalidFrame
from ropeway.networks.ros1.master import slave_call
from ropeway.networks.ros1.tcpros import encode_header, read_header
from ropeway.types.definition import short_name
from ropeway.types.ros1_types import ANY

if TYPE_CHECKING:
    from ropeway.networks.ros1.node import Ros1Node

__all__ = ["learn_type"]

_ASK_S: Final = 5.0


async def learn_type(node: Ros1Node, topic: str, type: str) -> bool:
    """Learn ``type`` (``pkg/msg/Name``) from the connection header of a publisher of ``topic``; true if one told.

    Raises ``ConnectFailed``, ``Refused`` and ``TypesError`` for what a publisher told that is of no use.
    """
    publishers = (await node.master.system_state())[0].get(topic, [])
    for name in publishers:
        uri = await node.master.lookup_node(name) if name != node.name else None
        if not uri:
            continue
        try:
            async with aio.timeout(_ASK_S):
                fields = await _ask(node, uri, topic, type)
        except (OSError, EOFError, TimeoutError, InvalidFrame) as error:
            raise ConnectFailed(uri, f"{name} does not tell what {type} is: {error or 'no answer in time'}") from None
        if "message_definition" in fields:
            node.types.learn(type, fields.get("md5sum", ""), fields["message_definition"])
            return True
    return False


async def _ask(node: Ros1Node, uri: str, topic: str, type: str) -> dict[str, str]:
    """Return the header with which a publisher answers ours."""
    answer = await slave_call(node.rpc, uri, "requestTopic", node.name, topic, [["TCPROS"]])
    match answer:
        case ["TCPROS", str(host), int(port), *_]:
            reader, writer = await asyncio.open_connection(host, port)
        case _:
            raise InvalidFrame("its answer to requestTopic is of no use")
    try:
        fields = {"callerid": node.name, "md5sum": ANY, "topic": topic, "type": short_name(type)}
        writer.write(encode_header(fields))
        return await read_header(reader)
    finally:
        writer.close()
