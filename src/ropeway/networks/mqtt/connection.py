"""Keeps a connection with a broker: dials it, stays subscribed, sends what it is given, and connects again.

The protocol is paho's. Its client runs on the event loop: reading takes what has come as one batch, writing goes on
when the socket takes more. Only dialling, which waits for names, connections and TLS, has a thread.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import random
import socket
import ssl
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, Final

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import MQTTErrorCode
from paho.mqtt.subscribeoptions import SubscribeOptions

from ropeway import aio
from ropeway.errors import GraphUnavailable
from ropeway.limits import MQTT_IN_FLIGHT, MQTT_UNREAD_BYTES
from ropeway.logs import failed
from ropeway.networks.mqtt.dialling import ANSWER_S, ConnectionPlan, advice, dial, drop, reason_of
from ropeway.tasks import Supervised, end

__all__ = ["BrokerLimits", "MqttConnection", "Wish"]

log = logging.getLogger("ropeway.mqtt")

_PAUSE_S: Final = (0.25, 8.0)  # before another attempt, doubling
_TURN_PACKETS: Final = 256
_TICK_S: Final = 0.5
_UNSENT_KERNEL_BYTES: Final = 128 << 10  # what waits in the kernel is stale, so little does
_LEAVE_S: Final = 1.0  # for what has not left yet when it is closed


@dataclass(frozen=True)
class Wish:
    """Says how a topic is to be read; ``retained``: the last value is wanted, too."""

    qos: int = 0
    retained: bool = False


@dataclass(frozen=True)
class BrokerLimits:
    """Holds what a broker says that it takes."""

    in_flight: int = MQTT_IN_FLIGHT
    qos: int = 1
    retains: bool = True
    packet_bytes: int = 268_435_455


class MqttConnection:
    """A connection that is made again whenever it is lost. It belongs to the event loop.

    ``on_messages`` gets what was read, in batches; ``on_state`` is called when it is connected and when that is over;
    ``on_ready`` when it takes more; ``on_published`` with the number of a message and why the broker refused it, ``""``
    if it took it; ``on_refused`` with a filter that may not be read, and why.
    """

    def __init__(self, name: str, plan: ConnectionPlan) -> None:
        self.name, self.plan = name, plan
        self.connected = False
        self.error = "not connected yet"
        self.limits = BrokerLimits()
        self.dials = 0
        self.on_messages: Callable[[list[MQTTMessage]], None] = _nobody
        self.on_state: Callable[[bool], None] = _nobody
        self.on_ready: Callable[[], None] = _nobody
        self.on_published: Callable[[int, str], None] = _nobody
        self.on_refused: Callable[[str, str], None] = _nobody
        self._client: Client | None = None
        self._fd = -1
        self._writing = False
        self._wishes: dict[str, Wish] = {}
        self._asked: dict[int, tuple[str, asyncio.Future[str]]] = {}
        self._received: list[MQTTMessage] = []
        self._received_bytes = 0
        self._gone = asyncio.Event()
        self._drained = asyncio.Event()  # all that was given to the client has left
        self._closing = self._is_up = False
        self._first: asyncio.Future[None]
        self._keeping = Supervised(self._keep, f"{name}: connection")

    async def open(self, wait_s: float) -> None:
        """Begin to connect, and wait up to ``wait_s`` for it; with 0 not at all. Raises ``GraphUnavailable``."""
        self._first = asyncio.get_running_loop().create_future()
        self._keeping.start()
        if not wait_s:
            return
        try:
            async with aio.timeout(wait_s):
                await asyncio.shield(self._first)
        except TimeoutError:
            await self.close()
            raise GraphUnavailable(self.name, f"the broker did not answer within {wait_s:g} s: {self.error}") from None
        except GraphUnavailable:
            await self.close()
            raise

    async def close(self) -> None:
        """Take leave of the broker, and end."""
        self._closing = True
        if self.connected:
            with contextlib.suppress(TimeoutError):
                async with aio.timeout(_LEAVE_S):
                    await self._drained.wait()
            if (client := self._client) is not None:
                self._attempt(client.disconnect)
        await end(self._keeping)
        self.error = "it was closed"

    def renew(self, plan: ConnectionPlan, *, anew: bool) -> None:
        """Use other credentials from the next connection on; with ``anew`` at once."""
        self.plan = plan
        if anew:
            self._gone.set()

    # ── what is read ───────────────────────────────────────────────────────────────────────────────────────────

    async def subscribe(self, filter: str, wish: Wish) -> str:
        """Read a topic or filter from now on, on every connection; return why the broker refuses it, ``""`` if not.

        The answer is waited for where there is a connection, so that nothing published afterwards is missed.
        """
        self._wishes[filter] = wish
        answer = self._ask(filter, wish)
        if answer is None:
            return ""
        try:
            async with aio.timeout(ANSWER_S):
                return await answer
        except TimeoutError:
            return ""  # a broker that is silent for longer is found out by the keep-alive

    def unsubscribe(self, filter: str) -> None:
        """Read a topic or filter no longer."""
        if self._wishes.pop(filter, None) is not None and self.connected and self._client is not None:
            client = self._client
            self._attempt(lambda: client.unsubscribe(filter))
            self._arm()

    def _ask(self, filter: str, wish: Wish) -> asyncio.Future[str] | None:
        client = self._client
        if client is None or not self.connected:
            return None
        options = SubscribeOptions(
            qos=min(wish.qos, self.limits.qos),
            noLocal=True,
            retainHandling=SubscribeOptions.RETAIN_SEND_ON_SUBSCRIBE
            if wish.retained
            else SubscribeOptions.RETAIN_DO_NOT_SEND,
        )
        found = self._attempt(
            lambda: client.subscribe(filter, options=options) if self.plan.five else client.subscribe(filter, wish.qos)
        )
        self._arm()
        if found is None or found[1] is None:
            return None
        answer: asyncio.Future[str] = asyncio.get_running_loop().create_future()
        self._asked[found[1]] = (filter, answer)
        return answer

    # ── what is sent ───────────────────────────────────────────────────────────────────────────────────────────

    @property
    def free(self) -> bool:
        """Whether the broker is there, and the last message has left."""
        client = self._client
        return self.connected and client is not None and not client.want_write()

    def publish(self, topic: str, payload: bytes, qos: int, retain: bool, properties: Any) -> int | None:
        """Send a message; return its number, ``None`` where there is no connection any more."""
        client = self._client
        if client is None or not self.connected:
            return None
        limits = self.limits
        info = self._attempt(
            lambda: client.publish(topic, payload, min(qos, limits.qos), retain and limits.retains, properties)
        )
        self._arm()
        if info is None or info.rc != MQTTErrorCode.MQTT_ERR_SUCCESS:
            return None
        return int(info.mid)

    # ── the connection ─────────────────────────────────────────────────────────────────────────────────────────

    async def _keep(self) -> None:
        pause_s = _PAUSE_S[0]
        while True:
            began = asyncio.get_running_loop().time()
            await self._stay()
            if asyncio.get_running_loop().time() - began > 2 * _PAUSE_S[1]:
                pause_s = _PAUSE_S[0]  # it was good for a while
            await asyncio.sleep(pause_s * random.uniform(0.7, 1.3))  # noqa: S311 - so that not all come at once
            pause_s = min(2 * pause_s, _PAUSE_S[1])

    async def _stay(self) -> None:
        """Connect, and return when that has failed or is over."""
        self.dials += 1
        self._gone.clear()
        loop = asyncio.get_running_loop()
        try:
            client = await dial(self.plan)
        except (OSError, ValueError) as error:
            self._failed(reason_of(error))
            return
        try:
            self._attach(client)
            deadline = loop.time() + ANSWER_S
            while not self._gone.is_set():
                with contextlib.suppress(TimeoutError):
                    async with aio.timeout(_TICK_S):
                        await self._gone.wait()
                self._attempt(client.loop_misc)
                if not self.connected and loop.time() > deadline:
                    self._failed(f"the broker did not answer within {ANSWER_S:g} s")
        finally:
            self._forget(client)

    def _attach(self, client: Client) -> None:
        """Let the event loop drive a client that has connected."""
        found = client.socket()
        if found is None:
            self._failed("the broker closed the connection")
            return
        self._client, self._fd = client, found.fileno()
        client.on_connect = self._on_connect
        client.on_disconnect = self._on_disconnect
        client.on_message = self._on_message
        client.on_publish = self._on_publish
        client.on_subscribe = self._on_subscribe
        client.on_socket_close = self._on_socket_close
        if isinstance(found, socket.socket):
            with contextlib.suppress(OSError, AttributeError):
                found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NOTSENT_LOWAT, _UNSENT_KERNEL_BYTES)
        asyncio.get_running_loop().add_reader(self._fd, self._readable)
        self._look_after_writing()

    def _failed(self, why: str) -> None:
        """Note why there is no connection."""
        if why != self.error and not self._closing:
            log.warning("%s: %s", self.name, why)
        self.error = why
        self.connected = False
        self._gone.set()
        if not self._first.done():
            self._first.set_exception(GraphUnavailable(self.name, why))
            self._first.exception()  # it may be that nobody waits

    def _forget(self, client: Client) -> None:
        """Let go of a client whose connection is over."""
        self._stop_watching()
        self._client = None
        drop(client)
        asked, self._asked = self._asked, {}
        for _, answer in asked.values():
            if not answer.done():
                answer.set_result("")
        self._received, self._received_bytes = [], 0
        self.connected = False
        if self._is_up:
            self._is_up = False
            self.on_state(False)

    def _stop_watching(self) -> None:
        if self._fd >= 0:
            loop = asyncio.get_running_loop()
            loop.remove_reader(self._fd)
            loop.remove_writer(self._fd)
        self._fd, self._writing = -1, False

    # ── what the event loop calls ──────────────────────────────────────────────────────────────────────────────

    def _readable(self) -> None:
        """Take what has come, as one batch."""
        client = self._client
        for _ in range(_TURN_PACKETS):
            if client is None or client.socket() is None:
                break
            before = len(self._received)
            self._attempt(client.loop_read)
            if self._received_bytes > MQTT_UNREAD_BYTES or (len(self._received) == before and not _decrypted(client)):
                break
        if client is not None and _decrypted(client):  # of which the loop is not told
            asyncio.get_running_loop().call_soon(self._readable)
        if self._received:
            batch, self._received, self._received_bytes = self._received, [], 0
            self.on_messages(batch)
        self._look_after_writing()

    def _writable(self) -> None:
        client = self._client
        if client is not None:
            self._attempt(client.loop_write)
            self._look_after_writing()

    def _look_after_writing(self) -> None:
        """Go on: be called when the socket takes more, or let more be sent."""
        if self._arm() and self.connected:
            self.on_ready()

    def _arm(self) -> bool:
        """Be called when the socket takes more, as long as something is left; return whether nothing is."""
        client = self._client
        if client is None or self._fd < 0:
            return False
        wanted = client.want_write()
        if wanted and not self._writing:
            asyncio.get_running_loop().add_writer(self._fd, self._writable)
        elif not wanted and self._writing:
            asyncio.get_running_loop().remove_writer(self._fd)
        self._writing = wanted
        if wanted:
            self._drained.clear()
        else:
            self._drained.set()
        return not wanted

    def _attempt(self, act: Callable[[], Any]) -> Any:
        """Let the client do something; what it fails with ends the connection, and no more."""
        try:
            return act()
        except Exception as error:  # of a library that reads what a broker wrote
            failed(log, "%s: the connection is given up", self.name)
            self._failed(reason_of(error))
            return None

    # ── what the client calls ──────────────────────────────────────────────────────────────────────────────────

    def _on_connect(self, client: Client, _: object, flags: object, reason: Any, properties: Any) -> None:
        if reason.is_failure:
            self._failed(f"the broker refuses the connection: {reason}{advice(str(reason))}")
            return
        self.limits = _limits(properties)
        self.connected, self.error = True, ""
        if not self._first.done():
            self._first.set_result(None)
        asyncio.get_running_loop().call_soon(self._resume, client)

    def _resume(self, client: Client) -> None:
        """Go on after a connection was made, outside of the client's own callback."""
        if client is not self._client or not self.connected:
            return
        log.info("%s: connected", self.name)
        self._is_up = True
        for filter, wish in self._wishes.items():
            self._ask(filter, wish)
        self.on_state(True)
        self._look_after_writing()

    def _on_disconnect(self, client: Client, _: object, flags: object, reason: Any, properties: object) -> None:
        if client is self._client and not self._gone.is_set():
            self._failed(f"the connection with the broker is lost: {reason}")

    def _on_socket_close(self, client: Client, *_: object) -> None:
        if client is self._client:
            self._stop_watching()
            self._gone.set()

    def _on_message(self, client: Client, _: object, message: MQTTMessage) -> None:
        self._received.append(message)
        self._received_bytes += len(message.payload)

    def _on_publish(self, client: Client, _: object, mid: int, reason: Any, properties: object) -> None:
        self.on_published(mid, str(reason) if reason.is_failure else "")

    def _on_subscribe(self, client: Client, _: object, mid: int, reasons: Sequence[Any], properties: object) -> None:
        filter, answer = self._asked.pop(mid, ("", None))
        refused = next((str(reason) for reason in reasons if reason.is_failure), "")
        if answer is not None and not answer.done():
            answer.set_result(refused)
        if refused:
            self.on_refused(filter, refused)


def _decrypted(client: Client) -> bool:
    """Return whether TLS has taken more from the socket than was read."""
    found = client.socket()
    return isinstance(found, ssl.SSLSocket) and found.pending() > 0


def _limits(properties: Any) -> BrokerLimits:
    """Return what a broker says in its answer to a connection; older ones say nothing."""
    return BrokerLimits(
        in_flight=min(getattr(properties, "ReceiveMaximum", MQTT_IN_FLIGHT), MQTT_IN_FLIGHT),
        qos=min(getattr(properties, "MaximumQoS", 1), 1),
        retains=bool(getattr(properties, "RetainAvailable", 1)),
        packet_bytes=getattr(properties, "MaximumPacketSize", BrokerLimits.packet_bytes),
    )


def _nobody(*_: object) -> None:
    """Tell nobody."""
