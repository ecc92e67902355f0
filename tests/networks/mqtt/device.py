"""A client of a broker that knows nothing of ROS, as devices are."""

from __future__ import annotations

import threading
from types import TracebackType
from typing import Any

from paho.mqtt.client import Client, MQTTMessage
from paho.mqtt.enums import CallbackAPIVersion, MQTTProtocolVersion

from tests.support.until import PATIENCE_S

from .broker import Broker

__all__ = ["Device"]


class Device:
    """Publishes, and keeps what it reads; it runs in a thread of its own."""

    def __init__(self, broker: Broker, *filters: str, user: str = "", password: str = "") -> None:
        self.messages: list[MQTTMessage] = []
        self._ready = threading.Event()
        self._client = Client(CallbackAPIVersion.VERSION2, protocol=MQTTProtocolVersion.MQTTv311)
        self._client.on_message = lambda _, __, message: self.messages.append(message)
        self._client.on_subscribe = lambda *_: self._ready.set()
        if user:
            self._client.username_pw_set(user, password)
        self._broker, self._filters = broker, filters

    @property
    def got(self) -> list[tuple[str, bytes]]:
        """The topics and payloads that it read."""
        return [(message.topic, bytes(message.payload)) for message in self.messages]

    def publish(self, topic: str, payload: bytes | str = b"", *, qos: int = 1, retain: bool = False) -> None:
        """Publish, and wait for the broker to have it."""
        self._client.publish(topic, payload, qos, retain).wait_for_publish(PATIENCE_S)

    def publish_all(self, messages: list[tuple[str, bytes]], **options: Any) -> None:
        """Publish many, and wait for the last."""
        infos = [self._client.publish(topic, payload, 1, **options) for topic, payload in messages]
        infos[-1].wait_for_publish(PATIENCE_S)

    def __enter__(self) -> Device:
        self._client.connect("127.0.0.1", self._broker.port)
        self._client.loop_start()
        for filter in self._filters:
            self._ready.clear()
            self._client.subscribe(filter, 1)
            assert self._ready.wait(PATIENCE_S)
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self._client.disconnect()
        self._client.loop_stop()
