"""The bodies of requests and answers, and the texts and codes of failures, between a client and the graph."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ropeway.errors import DecodeError, TypesError, ValueMismatch
from ropeway.graph.calls import new_id
from ropeway.networks.rosbridge.client.call_notes import failure, read_note
from ropeway.networks.rosbridge.protocol import codec as wire_codec
from ropeway.networks.rosbridge.protocol.dialect import ROSBRIDGE
from ropeway.types.definition import short_name

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.protocol import ops
    from ropeway.networks.rosbridge.server.host import SessionHost
    from ropeway.types import MessageCodec

__all__ = [
    "answer_encoding",
    "codec_of",
    "decode_args",
    "decode_body",
    "failure_note",
    "known_type_of",
    "learn_type",
    "passage",
    "text_of",
    "type_of",
]


def type_of(session: SessionHost, name: str, kind: str) -> str:
    """Return the full name of the type of ``kind`` (msg, srv, action) that a client named.

    Raises ``InvalidTypeName``.

    A middle part that leads nowhere counts for nothing with rosbridge: ``std_srvs/msg/Trigger`` is a service, too.
    """
    registry = session.registry
    if session.peer.dialect is ROSBRIDGE and not registry.has(name, kind):
        parts = [part for part in name.split("/") if part]
        if len(parts) == 3 and parts[1] != kind and registry.has(f"{parts[0]}/{kind}/{parts[2]}"):
            return registry.canonical(f"{parts[0]}/{kind}/{parts[2]}", kind)
    return registry.canonical(name, kind)


async def known_type_of(session: SessionHost, name: str, kind: str) -> str:
    """Return the same, and ask the network for the definition where it is not known. Raises ``InvalidTypeName``."""
    type = type_of(session, name, kind)
    await learn_type(session, type)
    return type


async def learn_type(session: SessionHost, type: str) -> None:
    """Ask the network for a definition that is not known; gateways do without, and ask when they need it."""
    if not session.gateway and not session.registry.has(type):
        await session.view.learn(type)


def codec_of(session: SessionHost, type: str) -> MessageCodec | None:
    """Return the codec of a type; ``None`` if a gateway can do without. Raises ``TypesError``."""
    try:
        return session.codec(type)
    except TypesError:
        if session.gateway:
            return None
        raise


def decode_body(session: SessionHost, value: Any, compression: str | None, type: str) -> bytes:
    """Decode ``args`` or ``values`` that a client sent to CDR. Raises ``TypesError`` or ``MessageTooBig``.

    What says nothing (left out, ``null``, an empty text) is a message of default values, as rosbridge has it.
    """
    codec = codec_of(session, type)
    limit_bytes = session.peer.limit_bytes
    if session.peer.dialect is ROSBRIDGE:
        compression = None  # its clients name one for the answer, and rosbridge ignores it
    if codec is None:
        if not isinstance(value, (bytes, bytearray, memoryview)):
            raise DecodeError(type, compression or "none", "the definition of its type is not known")
        return wire_codec.decode_publish_msg(value, compression, None, limit_bytes=limit_bytes)
    if not value and isinstance(value, (str, int, float)):
        value = None
    if isinstance(value, (str, int, float)):
        short = short_name(type)
        raise ValueMismatch(type, "", f"Expected a JSON object for type {short} but received a {value.__class__}")
    return wire_codec.decode_value(value, compression, codec, limit_bytes=limit_bytes)


def decode_args(session: SessionHost, value: Any, compression: str | None, type: str) -> bytes:
    """Decode the ``args`` of a request to CDR. Raises ``TypesError`` or ``MessageTooBig``.

    What is neither an object nor a list asks for nothing in particular, as rosbridge has it.
    """
    if session.gateway and value.__class__ is bytes:
        return wire_codec.decode_value(
            value, compression, codec_of(session, type), limit_bytes=session.peer.limit_bytes
        )
    if session.peer.dialect is ROSBRIDGE and not isinstance(value, (dict, list)):
        value = None
    return decode_body(session, value, compression, type)


def answer_encoding(session: SessionHost, op: ops.CallService | ops.SendActionGoal) -> str:
    """Return the encoding that a client asked for its answers to be in."""
    if session.gateway:
        return str((op.ropeway or {}).get("encoding") or "auto")
    return op.compression or "none"


def text_of(error: Exception) -> str:
    """Return the text of an error for a client: rosbridge's own text if it has one."""
    return error.reason if isinstance(error, ValueMismatch) else str(error)


def failure_note(session: SessionHost, error: Exception) -> dict[str, Any] | None:
    """Return what a gateway is told besides the text."""
    return failure(error)[0] if session.gateway else None


def passage(session: SessionHost, note: Mapping[str, Any] | None) -> tuple[bytes, tuple[str, ...], str]:
    """Return the ``id``, ``via`` and ``caller`` of a request; those of other clients than gateways have a new id."""
    peer = session.peer.connection.peer
    if not session.gateway:
        return new_id(), (), peer
    id, via, caller, _ = read_note(note)
    return id, via, caller or session.remote.get("name") or peer
