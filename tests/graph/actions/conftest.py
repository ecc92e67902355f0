"""Two participants of a ``memory`` network, and an action that waits."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator
from typing import Any

import pytest

from ropeway.graph.actions import ActionParts, ComposedActionClient, ComposedActionServer
from ropeway.graph.calls import ActionHandlers, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry
from tests.support.actions import FIBONACCI, order, sequence

REGISTRY = TypeRegistry()
_numbers = itertools.count()


class Worker:
    """Carries goals out until it is told to end them."""

    def __init__(self) -> None:
        self.goals: list[ServerGoal] = []
        self.finish = asyncio.Event()
        self.outcome = Outcome(GoalStatus.SUCCEEDED, sequence(1))

    async def __call__(self, goal: ServerGoal) -> Outcome:
        self.goals.append(goal)
        await self.finish.wait()
        return self.outcome


class Scene:
    """A server on one participant; the other calls the services that it is made of."""

    def __init__(self, near: MemoryGraph, far: MemoryGraph) -> None:
        self.near, self.far = near, far
        self.worker = Worker()
        self.parts = ActionParts("/count", FIBONACCI, REGISTRY)

    async def serve(self, **handlers: Any) -> ComposedActionServer:
        """Serve the action on the far side."""
        done = ActionHandlers(handlers.pop("execute", self.worker), **handlers)
        return await self.far.create_action_server("/count", FIBONACCI, done)

    async def use(self) -> ComposedActionClient:
        """Use the action from the near side."""
        return await self.near.create_action_client("/count", FIBONACCI)

    async def call(self, service: str, type: str, payload: bytes) -> bytes:
        """Call one of the services of the action."""
        client = await self.near.create_client(service, type)
        try:
            return await client.call(Request(payload), 5)
        finally:
            await client.close()

    async def send(self, id: bytes, value: int = 1) -> bool:
        """Send a goal by hand, and see whether it is accepted."""
        payload = self.parts.join(id, order(value))
        return self.parts.is_accepted(await self.call(self.parts.send_goal, self.parts.send_goal_type, payload))

    async def result(self, id: bytes) -> tuple[int, bytes]:
        """Ask for a result by hand."""
        payload = self.parts.result_request(id)
        return self.parts.outcome(await self.call(self.parts.get_result, self.parts.get_result_type, payload))

    async def cancel(self, id: bytes = bytes(16), stamp_ns: int = 0) -> tuple[int, list[bytes]]:
        """Cancel by hand."""
        payload = self.parts.cancel_request(id, stamp_ns)
        return self.parts.cancel_answer(await self.call(self.parts.cancel_goal, "action_msgs/srv/CancelGoal", payload))


@pytest.fixture
async def scene() -> AsyncIterator[Scene]:
    """Two participants of one network."""
    network = f"action-{next(_numbers)}"
    near = MemoryGraph(network, node="/near", registry=REGISTRY)
    far = MemoryGraph(network, node="/far", registry=REGISTRY)
    await near.open()
    await far.open()
    yield Scene(near, far)
    await near.close()
    await far.close()
