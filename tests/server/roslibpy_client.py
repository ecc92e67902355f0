"""Clients of roslibpy, run as a program of their own by the tests: its transports exclude each other in one process.

``python roslibpy_client.py TRANSPORT PORT PLAN``; the plan and what is written are those of ``tests/js/client.mjs``.
"""

from __future__ import annotations

import json
import sys
import threading
from typing import Any

import roslibpy

_lock = threading.Lock()


def say(**what: Any) -> None:
    """Tell the test something."""
    with _lock:
        print(json.dumps(what), flush=True)


def make(ros: roslibpy.Ros, number: int, item: dict[str, Any]) -> roslibpy.Topic:
    """The topic of one item of the plan."""
    options = {k: v for k, v in item.items() if k not in ("client", "name", "type", "message")}
    return roslibpy.Topic(ros, item["name"].replace("#", str(number)), item["type"], **options)


def main() -> None:
    """Connect all clients, then publish at each line of stdin."""
    transport, port, text = sys.argv[1:]
    plan = json.loads(text)
    publishers: list[tuple[roslibpy.Topic, dict[str, Any]]] = []
    clients = []
    for number in range(plan.get("clients", 1)):
        ros = roslibpy.Ros("127.0.0.1", int(port), transport=transport)
        clients.append(ros)
        ros.on("close", lambda _, n=number: say(client=n, closed=True))
        ros.on("ready", lambda _, n=number: say(client=n, connected=True))
        for item in plan.get("subscribe", ()):
            if item.get("client", number) == number:
                reader = make(ros, number, item)
                reader.subscribe(lambda m, n=number, name=reader.name: say(client=n, topic=name, message=dict(m)))
        for item in plan.get("publish", ()):
            if item.get("client", number) == number:
                writer = make(ros, number, item)
                writer.advertise()
                publishers.append((writer, item["message"]))
        ros.run()
    for _ in sys.stdin:
        for writer, message in publishers:
            writer.publish(roslibpy.Message(message))
    for ros in clients:
        ros.close()
    clients[0].terminate()


if __name__ == "__main__":
    main()
