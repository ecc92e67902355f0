"""A group on the robot's own graph: its profile as a topic, and services to optimise, list, switch and pause.

They have types that every ROS 2 has: a node needs nothing of ours to use them.
"""

from __future__ import annotations

import asyncio
import json
import re
import time
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack
from typing import Any, Final

from ropeway.errors import RopewayError
from ropeway.gateway.group_commands import GroupCommands
from ropeway.graph.base import SEQ_NONE, Graph, Sample, new_origin
from ropeway.graph.calls import Request
from ropeway.qos import LATCHED
from ropeway.tasks import Supervised, describe
from ropeway.types import TypeRegistry

__all__ = ["GroupServices"]

_PROFILE_TYPE: Final = "diagnostic_msgs/msg/DiagnosticArray"
_TRIGGER: Final = "std_srvs/srv/Trigger"
_SET_BOOL: Final = "std_srvs/srv/SetBool"
_PERIOD_S: Final = 1.0
_OK, _WARN, _ERROR, _STALE = range(4)  # levels of diagnostic_msgs/DiagnosticStatus
_LEVELS: Final = {"met": _OK, "missed": _WARN, "unknown": _STALE}

Command = Callable[[], dict[str, Any] | Awaitable[dict[str, Any]]]


class GroupServices:
    """Offers the commands of one group below ``base``, such as ``/robot1/anycast``."""

    def __init__(self, commands: GroupCommands, registry: TypeRegistry, base: str) -> None:
        self._commands, self._registry, self._base = commands, registry, base
        self._profile = registry.codec(_PROFILE_TYPE)
        self._stack = AsyncExitStack()
        self._origin = new_origin()

    async def open(self, view: Graph) -> None:
        """Offer everything on a graph. Raises what the graph raises; nothing is offered then."""
        async with AsyncExitStack() as stack:
            publisher = await view.create_publisher(f"{self._base}/profile", _PROFILE_TYPE, LATCHED)
            stack.push_async_callback(publisher.close)
            commands: dict[str, Command] = {
                "optimise": self._commands.optimise,
                "list_profiles": self._commands.report,
                **{f"switch_to/{name}": self._switch(member) for name, member in self._members().items()},
            }
            for name, command in commands.items():
                service = await view.create_service(f"{self._base}/{name}", _TRIGGER, self._trigger(command))
                stack.push_async_callback(service.close)
            pause = await view.create_service(f"{self._base}/pause", _SET_BOOL, self._pause)
            stack.push_async_callback(pause.close)

            async def tell() -> None:
                while True:  # also while nobody reads: who comes later gets the last one first
                    publisher.publish(self._message())
                    await asyncio.sleep(_PERIOD_S)

            stack.push_async_callback(Supervised(tell, f"profile on {self._base}").start().close)
            self._stack = stack.pop_all()

    async def close(self) -> None:
        """Take everything back."""
        await self._stack.aclose()

    def _members(self) -> dict[str, str]:
        """Return the members by names that ROS takes: those of the policy, else their addresses."""
        report = self._commands.report()
        named = _machines(report)
        return {_ros_name(named.get(member, member)): member for member in report["members"]}

    def _switch(self, member: str) -> Command:
        return lambda: self._commands.switch(member)

    def _trigger(self, command: Command) -> Callable[[Request], Awaitable[bytes]]:
        codec = self._registry.codec(f"{_TRIGGER}_Response")

        async def answer(_: Request) -> bytes:
            try:
                found = command()
                report = found if isinstance(found, dict) else await found
            except RopewayError as error:
                return codec.encode({"success": False, "message": describe(error)})
            return codec.encode({"success": True, "message": json.dumps(report)})

        return answer

    async def _pause(self, request: Request) -> bytes:
        paused = bool(self._registry.codec(f"{_SET_BOOL}_Request").decode(request.payload)["data"])
        report = self._commands.pause(paused)
        current = report["current"]
        who = _machines(report).get(current, current) or "nobody is in use; who comes first"
        answer = {"success": True, "message": f"{who} is {'kept' if paused else 'judged again'}"}
        return self._registry.codec(f"{_SET_BOOL}_Response").encode(answer)

    def _message(self) -> Sample:
        report = self._commands.report()
        now_ns = time.time_ns()
        sec, nanosec = divmod(now_ns, 1_000_000_000)
        named, current = _machines(report), report["current"]
        rows = [_row(name, member, current, named.get(name, "")) for name, member in report["members"].items()]
        message = {"header": {"stamp": {"sec": sec, "nanosec": nanosec}}, "status": rows}
        return Sample(self._profile.encode(message), _PROFILE_TYPE, now_ns, self._origin, SEQ_NONE)


def _machines(report: dict[str, Any]) -> dict[str, str]:
    """Return the name that the policy gives each member, by its address."""
    return {address: machine for machine, address in report["machines"].items()}


def _row(name: str, member: dict[str, Any], current: str, machine: str) -> dict[str, Any]:
    """Return a member as a ``DiagnosticStatus``; what is not known has no value."""
    state = "gone" if not member["here"] else "in use" if name == current else "standby"
    level = _LEVELS[member["standing"]] if member["here"] else _ERROR
    values = {**(member["latency_s"] or {}), "in_flight": member["in_flight"]}
    if machine:
        values["machine"] = machine
    if member["fit"] is not None:
        values["goodness_of_variance_fit"] = member["fit"]
        values["classes"] = json.dumps(member["classes"])
    return {
        "level": bytes([level]),
        "name": name,
        "message": f"{state}, bound {member['standing']}",
        "hardware_id": name,
        "values": [{"key": key, "value": str(value)} for key, value in values.items()],
    }


def _ros_name(member: str) -> str:
    """Return a member's name as a part of a ROS name: ``ws://edge-1:9090`` becomes ``edge_1_9090``."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", member.partition("://")[2] or member).strip("_")
    return plain if plain[:1].isalpha() else f"m_{plain}"
