"""Dials a broker: makes a client of paho's, and connects it in a thread, since that waits for names and TLS."""

from __future__ import annotations

import asyncio
import contextlib
import ssl
import threading
from dataclasses import dataclass, field
from typing import Any, Final

from paho.mqtt.client import Client
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from ropeway.networks.mqtt.wire import connect_properties

__all__ = ["ANSWER_S", "ConnectionPlan", "advice", "dial", "drop", "reason_of"]

ANSWER_S: Final = 5.0
"""Time for a connection, for a TLS handshake, and for each answer of a broker."""

_PACKET_HEAD_BYTES: Final = 70_000  # the longest topic, and properties


@dataclass(frozen=True)
class ConnectionPlan:
    """Says how a broker is dialled.

    ``will_topic`` is the topic whose retained message the broker takes away when the connection is lost.
    """

    host: str
    port: int
    client_id: str
    user: str = ""
    password: str | None = field(default=None, repr=False)
    context: ssl.SSLContext | None = None
    version: str = "5"
    keep_alive_s: int = 5
    max_message_bytes: int = 64 << 20
    will_topic: str = ""

    @property
    def five(self) -> bool:
        """Whether MQTT 5 is spoken, and not 3.1.1."""
        return self.version == "5"


async def dial(plan: ConnectionPlan) -> Client:
    """Connect. Raises ``OSError``, or ``ValueError`` for a host that cannot be one."""
    client, lock, abandoned = _make_client(plan), threading.Lock(), False

    def connect() -> None:
        options: dict[str, Any] = {}
        if plan.five:
            properties = connect_properties(plan.max_message_bytes + _PACKET_HEAD_BYTES)
            options = {"clean_start": True, "properties": properties}
        try:
            client.connect(plan.host, plan.port, plan.keep_alive_s, **options)
        finally:
            with lock:
                if abandoned:
                    drop(client)

    try:
        await asyncio.to_thread(connect)
    except BaseException:  # a cancellation leaves the thread behind, which closes what it makes
        with lock:
            abandoned = True
            drop(client)
        raise
    return client


def drop(client: Client) -> None:
    """Close the socket of a client, whatever the client thinks of it."""
    found = client.socket()
    if found is not None:
        with contextlib.suppress(OSError):
            found.close()


def _make_client(plan: ConnectionPlan) -> Client:
    client = Client(
        CallbackAPIVersion.VERSION2,
        client_id=plan.client_id,
        protocol=MQTTProtocolVersion.MQTTv5 if plan.five else MQTTProtocolVersion.MQTTv311,
        reconnect_on_failure=False,
    )
    client.connect_timeout = ANSWER_S
    client.max_inflight_messages = 0  # who sends counts, and so knows what is under way
    if plan.user:
        client.username_pw_set(plan.user, plan.password)
    if plan.will_topic:
        client.will_set(plan.will_topic, b"", qos=1, retain=True)
    if plan.context is not None:
        client.tls_set_context(plan.context)
        if not plan.context.check_hostname:
            client.tls_insecure_set(True)
    return client


def reason_of(error: BaseException) -> str:
    """Return why a connection failed, for people."""
    if isinstance(error, ssl.SSLCertVerificationError):
        why = getattr(error, "verify_message", error)  # of the library; Python's own have none
        return f"the certificate of the broker is not trusted: {why}; name its authority as ca"
    if isinstance(error, ssl.SSLError):
        return f"TLS with the broker failed: {getattr(error, 'reason', None) or error}"
    if isinstance(error, TimeoutError):
        return f"the broker did not answer within {ANSWER_S:g} s"
    if isinstance(error, OSError):
        return f"the broker cannot be reached: {error.strerror or error}"
    return f"the broker cannot be spoken to: {error}"


def advice(reason: str) -> str:
    """Return what to do about a refusal, as the broker words it."""
    lowered = reason.lower()
    if "authori" in lowered or "password" in lowered:
        return "; check the user, the password and the client certificate"
    if "protocol version" in lowered:
        return "; it may be an older one, for version=3.1.1"
    return ""
