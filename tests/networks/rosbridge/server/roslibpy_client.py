"""Clients of roslibpy, run as a program of their own by the tests: its transports exclude each other in one process.

``python roslibpy_client.py TRANSPORT PORT PLAN``; the plan, the commands and what is written are those of
``tests/js/client.mjs``, as far as the library can do it: it carries out no goals.
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


def serve(ros: roslibpy.Ros, number: int, item: dict[str, Any]) -> None:
    """Serve the service of one item of the plan."""
    service = roslibpy.Service(ros, item["name"].replace("#", str(number)), item["type"])

    def answer(request: dict[str, Any], response: dict[str, Any]) -> bool:
        say(client=number, asked=service.name, args=dict(request))
        response.update(item.get("values", {}))
        return "fail" not in item

    service.advertise(answer)


_actions: dict[tuple[int, str], roslibpy.ActionClient] = {}


def carry_out(ros: roslibpy.Ros, number: int, command: dict[str, Any]) -> None:
    """Do what one line of stdin asks for."""
    args, type = command.get("args") or {}, command.get("type", "")

    def answered(values: Any) -> None:
        say(client=number, answered=command.get("call") or command.get("ask"), values=plain(values))

    def failed(error: Any) -> None:
        name = command.get("call") or command.get("goal") or command.get("ask")
        say(client=number, failed=name, text=str(plain(error)))

    if "call" in command:
        service = roslibpy.Service(ros, command["call"], type)
        service.call(roslibpy.ServiceRequest(args), answered, failed)
    elif "goal" in command:
        name = command["goal"]
        action = _actions.setdefault((number, name), roslibpy.ActionClient(ros, name, type))
        id = action.send_goal(
            roslibpy.Goal(args),
            lambda result: say(client=number, result=name, values=plain(result)),
            lambda feedback: say(client=number, feedback=name, values=plain(feedback)),
            failed,
        )
        say(client=number, sent=name, id=id)
    elif "cancel" in command:
        _actions[number, command["cancel"]].cancel_goal(command["id"])
    elif "ask" in command:
        getattr(ros, command["ask"])(*(args or []), callback=answered, errback=failed)


def plain(value: Any) -> Any:
    """What the library hands over, as JSON can say it."""
    if hasattr(value, "items"):
        return {key: plain(item) for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [plain(item) for item in value]
    return value.name if isinstance(value, roslibpy.GoalStatus) else value


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
        ros.run()  # first: the library may skip one of the handlers that it calls when a connection is ready
        for item in plan.get("subscribe", ()):
            if item.get("client", number) == number:
                reader = make(ros, number, item)
                reader.subscribe(lambda m, n=number, name=reader.name: say(client=n, topic=name, message=dict(m)))
        for item in plan.get("publish", ()):
            if item.get("client", number) == number:
                writer = make(ros, number, item)
                writer.advertise()
                publishers.append((writer, item["message"]))
        for item in plan.get("serve", ()):
            if item.get("client", number) == number:
                serve(ros, number, item)
        say(client=number, connected=True)
    for line in sys.stdin:
        if line.strip():
            command = json.loads(line)
            for number, ros in enumerate(clients):
                if command.get("client", number) == number:
                    carry_out(ros, number, command)
            continue
        for writer, message in publishers:
            writer.publish(roslibpy.Message(message))
    for ros in clients:
        ros.close()
    clients[0].terminate()


if __name__ == "__main__":
    main()
