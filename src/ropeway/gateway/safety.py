"""Keeps the guards of topics of commands: a lease that is over publishes the safe message, whatever the links do."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Mapping, Sequence
from contextlib import AsyncExitStack
from typing import Any, Final

from ropeway import aio
from ropeway.delivery.command_guard import CommandGuard, UnknownField
from ropeway.errors import ConfigError, TypesError, ValueMismatch
from ropeway.gateway.config.safety_model import SafetyItem
from ropeway.gateway.config.suggest import did_you_mean
from ropeway.graph.base import Publisher, Sample, resolve_name
from ropeway.hub.hub import Hub
from ropeway.tasks import Supervised
from ropeway.types import TypeRegistry

__all__ = ["GuardedTopic", "guard_topics"]

log = logging.getLogger("ropeway.gateway")

_REPEATS: Final = 3
"""How often the safe message is published: a reader with best effort may lose one."""
_REPEAT_S: Final = 0.05


class GuardedTopic:
    """A topic of a local graph with a guard, and the publisher of its safe message."""

    def __init__(self, item: SafetyItem, guard: CommandGuard) -> None:
        self.topic, self.type, self.guard = resolve_name(item.topic), item.type, guard
        self._publisher: Publisher | None = None
        self._driven = asyncio.Event()

    def admit(self, sample: Sample, driver: str) -> Sample | None:
        """See ``Gate.admit``."""
        admitted = self.guard.admit(sample, driver)
        if admitted is not None and not self._driven.is_set():
            self._driven.set()
        return admitted

    async def open(self, hub: Hub, stack: AsyncExitStack) -> None:
        """Guard the topic from now on, as long as ``stack`` is open."""
        view = hub.view("command lease", alone=True)
        stack.push_async_callback(view.close)
        self._publisher = await view.create_publisher(self.topic, self.type)
        hub.gates[self.topic] = self
        stack.callback(hub.gates.pop, self.topic)
        stack.push_async_callback(Supervised(self._watch, f"lease of {self.topic}").start().close)

    def status(self) -> dict[str, Any]:
        """Return the state as JSON."""
        return {"topic": self.topic, "type": self.type, **self.guard.status()}

    async def _watch(self) -> None:
        clock = asyncio.get_running_loop().time
        while True:
            due_s = self.guard.due_s
            if due_s is None:
                self._driven.clear()
                await self._driven.wait()
            elif due_s > clock():
                await asyncio.sleep(due_s - clock())
            else:
                await self._expire()

    async def _expire(self) -> None:
        if not self.guard.expire():
            return
        log.warning("%s: no command came within the lease, so the safe message is published", self.topic)
        assert self._publisher is not None
        self._driven.clear()
        for _ in range(_REPEATS):
            self._publisher.publish(self.guard.safe())
            try:
                async with aio.timeout(_REPEAT_S):
                    await self._driven.wait()
            except TimeoutError:
                continue
            return


async def guard_topics(
    items: Sequence[tuple[str, SafetyItem]], hubs: Mapping[str, Hub], registry: TypeRegistry, stack: AsyncExitStack
) -> list[GuardedTopic]:
    """Guard topics, given with their paths. Raises ``ConfigError`` for fields that a type does not have."""
    clock = asyncio.get_running_loop().time
    found = []
    for path, item in items:
        try:
            guard = CommandGuard(
                registry.codec(item.type),
                lease_s=item.lease_s,
                on_expiry=item.on_expiry if isinstance(item.on_expiry, dict) else None,
                most=item.max,
                lifespan_s=item.lifespan_s,
                drivers=item.drivers,
                clock=clock,
            )
        except UnknownField as error:
            text = f"{item.type} has no such number{did_you_mean(error.path, error.valid)}"
            raise ConfigError([(f"{path}.max.{error.path}", text)]) from None
        except ValueMismatch as error:
            raise ConfigError([(f"{path}.on_expiry", error.reason)]) from None
        except TypesError as error:
            raise ConfigError([(f"{path}.type", str(error))]) from None
        topic = GuardedTopic(item, guard)
        await topic.open(hubs[item.graph or next(iter(hubs))], stack)
        found.append(topic)
    return found
