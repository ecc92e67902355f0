"""Calls and goals under way when a link is cut or a machine dies: two machines and what is between."""

from __future__ import annotations

import time
from collections.abc import Awaitable, Callable
from typing import Any

import pytest

from tests.faults.conftest import Machine, Pair, took_s

from .node_types import ACTION, SERVICE

pytestmark = [pytest.mark.netns, pytest.mark.slow, pytest.mark.timeout(300)]

MakePair = Callable[[], Awaitable[Pair]]
NOTICED_S = 7.0  # what is promised is 5 s


def routes(prefix: str) -> dict[str, Any]:
    return {
        f"{prefix}-service": [{"name": "/slow", "type": SERVICE}],
        f"{prefix}-action": [{"name": "/move", "type": ACTION}],
    }


async def under_way(pair: Pair, prefix: str) -> tuple[Machine, Machine]:
    """A robot that serves and a cloud that uses, with a call and a goal under way; the robot dials, or the cloud."""
    dials, listens = ("a", "b") if prefix == "expose" else ("b", "a")
    address = {"a": pair.address_a, "b": pair.address_b}[listens]
    orders: dict[str, dict[str, Any]] = {"a": {"name": "robot", "serve": True}, "b": {"name": "cloud", "use": True}}
    orders[listens]["listen"] = [f"ws://{address}:9090"]
    orders[dials]["remotes"] = [{"address": f"ws://{address}:9090", **routes(prefix)}]
    machines = {where: await pair.machine(where, **orders[where]) for where in (listens, dials)}
    robot, cloud = machines["a"], machines["b"]
    await began(robot, 0.0)
    return robot, cloud


async def began(robot: Machine, since: float) -> None:
    """Wait until a call and a goal are with the provider."""
    await robot.until(lambda: robot.first("call", "began", since) and robot.first("goal", "began", since))


async def ended(machine: Machine, since: float) -> float:
    """Wait until the caller of both has got an error; gives how long that took."""
    await machine.until(
        lambda: (
            any("failed" in e and e["t"] >= since for e in machine.events) and machine.first("ended", "ABORTED", since)
        )
    )
    when = max(e["t"] for e in machine.events if ("failed" in e or "ended" in e) and e["t"] >= since)
    return took_s(since, when, machine)


async def cancelled(machine: Machine, since: float) -> float:
    """Wait until the provider was told to cancel its goal; gives how long that took."""
    await machine.until(lambda: machine.first("goal", "cancelled", since))
    when = machine.first("goal", "cancelled", since)
    assert when is not None
    return took_s(since, when, machine)


@pytest.mark.parametrize("prefix", ["expose", "reserve"])
@pytest.mark.parametrize("silently", [False, True])
async def test_link_is_cut(pair: MakePair, prefix: str, silently: bool) -> None:
    """A cut link fails the call, aborts the goal and cancels it at its provider; afterwards both work again."""
    net = await pair()
    robot, cloud = await under_way(net, prefix)
    since = time.monotonic()
    (net.swallow if silently else net.pull)()
    assert await ended(cloud, since) < NOTICED_S
    assert await cancelled(robot, since) < NOTICED_S
    back = time.monotonic()
    (net.swallow if silently else net.pull)(back=True)
    await began(robot, back)


@pytest.mark.parametrize("prefix", ["expose", "reserve"])
async def test_provider_is_killed(pair: MakePair, prefix: str) -> None:
    """A machine that dies in mid-call fails the call and aborts the goal at once."""
    net = await pair()
    robot, cloud = await under_way(net, prefix)
    since = time.monotonic()
    robot.kill()
    assert await ended(cloud, since) < 3


@pytest.mark.parametrize("prefix", ["expose", "reserve"])
async def test_caller_is_killed(pair: MakePair, prefix: str) -> None:
    """The goal of a machine that dies is cancelled at its provider."""
    net = await pair()
    robot, cloud = await under_way(net, prefix)
    since = time.monotonic()
    cloud.kill()
    assert await cancelled(robot, since) < 3
