"""Keeps the recorders of a gateway: puts them on the routes that they want, and shows them the links."""

from __future__ import annotations

import asyncio
import os
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, Protocol
from weakref import WeakSet

from ropeway import aio
from ropeway.bridge.topic import TopicBridge
from ropeway.errors import ConfigError
from ropeway.gateway.state_place import state_directory
from ropeway.tasks import Supervised, end

if TYPE_CHECKING:
    from ropeway.delivery.pipeline import Tap
    from ropeway.gateway.config.config import Config, Route
    from ropeway.gateway.config.record_model import RecordConfig
    from ropeway.gateway.recording.recorder import Recorder
    from ropeway.gateway.remote import Remote
    from ropeway.graph.base import Publisher
    from ropeway.hub.hub import Hub
    from ropeway.types import TypeRegistry

__all__ = ["RecorderHost", "Recorders", "check_directories"]

_LOOK_S: Final = 0.25  # links that do not tell are seen to be lost this late at most
_FIGURES_S: Final = 1.0


class RecorderHost(Protocol):
    """Has what is recorded; ``Gateway`` is one."""

    hubs: dict[str, Hub]
    registry: TypeRegistry

    @property
    def remotes(self) -> Sequence[Remote]:
        """The remotes that are up."""
        ...


def _directory(config: RecordConfig, gateway: str) -> Path:
    base = Path(config.directory) if config.directory else state_directory() / "recordings" / gateway
    return base / config.name


def check_directories(config: Config) -> None:
    """Raise ``ConfigError`` where a recorder cannot make its directory, or not write there."""
    problems = []
    for number, one in enumerate(config.gateway.record):
        directory = _directory(one, config.gateway.name)
        try:
            directory.mkdir(parents=True, exist_ok=True)
            reason = "" if os.access(directory, os.W_OK | os.X_OK) else "nothing can be written there"
        except OSError as error:
            reason = error.strerror or str(error)
        if reason:
            problems.append((f"gateway.record[{number}].directory", f"{directory}: {reason}"))
    if problems:
        raise ConfigError(problems)


class Recorders:
    """The recorders of a gateway. Without any, nothing here is on the way of a message, and nothing runs."""

    def __init__(self, host: RecorderHost, name: str, node: str | None = None) -> None:
        self._host, self._name = host, name
        self._part = "" if node is None else node.removeprefix(f"{name}_")  # of a worker
        self._recorders: dict[str, Recorder] = {}
        self._looking: Supervised | None = None
        self._told: WeakSet[Remote] = WeakSet()  # remotes that tell when their state changes
        self._changed = asyncio.Event()

    async def open(self, config: Config) -> None:
        """Begin what a configuration wants recorded. Raises ``ConfigError``."""
        check_directories(config)
        await self.change(config.gateway.record)

    async def change(self, configs: Sequence[RecordConfig]) -> None:
        """Have these recorders, and no others; those that stay the same go on."""
        wanted = {config.name: config for config in configs}
        for name, there in list(self._recorders.items()):
            if wanted.get(name) != there.config:
                del self._recorders[name]
                await there.stop()
        for name, config in wanted.items():
            if name not in self._recorders:
                await self._add(config)
        self._recorders = {name: self._recorders[name] for name in wanted}
        await self._put_on()

    async def _add(self, config: RecordConfig) -> None:
        from ropeway.gateway.recording.recorder import Recorder  # most gateways record nothing

        directory = _directory(config, self._name)
        made = Recorder(config, directory, self._host.hubs, self._host.registry, part=self._part)
        self._recorders[config.name] = made
        if config.active:
            await made.start()

    async def close(self) -> None:
        """End all of them; what was written is whole."""
        looking, self._looking = self._looking, None
        await end(looking)
        recorders, self._recorders = self._recorders, {}
        for recorder in recorders.values():
            await recorder.stop()

    # ── orders ─────────────────────────────────────────────────────────────────────────────────────────────────

    @property
    def names(self) -> list[str]:
        """The names of all recorders."""
        return list(self._recorders)

    def status(self) -> list[dict[str, Any]]:
        """Return how each is, as JSON."""
        return [recorder.status() for recorder in self._recorders.values()]

    def listed(self) -> list[dict[str, Any]]:
        """Return how each is, with the files that it has. Blocks."""
        return [
            {
                **recorder.status(),
                "files": [
                    {"path": str(one.path), "bytes": one.size_bytes, "changed": one.changed_s}
                    for one in recorder.files()
                ],
            }
            for recorder in list(self._recorders.values())
        ]

    async def start(self, name: str) -> None:
        """Start a recorder, or all with ``""``."""
        for recorder in self._called(name):
            await recorder.start()
        await self._put_on()

    async def stop(self, name: str) -> None:
        """Stop a recorder, or all with ``""``; what it was writing is whole."""
        for recorder in self._called(name):
            await recorder.stop()
        await self._put_on()

    def trigger(self, name: str, why: str) -> list[str]:
        """Trigger a clip of a recorder, or of all that have a ring with ``""``; return the names of those."""
        return [recorder.config.name for recorder in self._called(name) if recorder.trigger(why)]

    def _called(self, name: str) -> list[Recorder]:
        return [recorder for key, recorder in self._recorders.items() if name in ("", key)]

    # ── routes ─────────────────────────────────────────────────────────────────────────────────────────────────

    def tap(self, route: Route) -> Tap | None:
        """Return what gets the messages that cross a route, ``None`` where nobody records them."""
        if route.kind != "topic":
            return None
        sinks = tuple(recorder.put for recorder in self._recorders.values() if recorder.takes(route.name))
        if not sinks:
            return None
        from ropeway.gateway.recording.route_tap import RouteTap

        return RouteTap(route, self._host.registry, self._publisher_of(route), sinks)

    def _publisher_of(self, route: Route) -> Callable[[], Publisher | None]:
        """Return what finds the publisher of a route's bridge, which is made after the tap."""
        found: list[TopicBridge] = []

        def publisher() -> Publisher | None:
            if not found:
                there = (running for remote in self._host.remotes for running in remote.joined())
                found.extend(
                    running.bridge
                    for running in there
                    if running.route.key == route.key and isinstance(running.bridge, TopicBridge)
                )
            return found[0].publisher if found else None

        return publisher

    async def _put_on(self) -> None:
        """Put the recorders on the routes that they want now, take them off others, and look at links if one does."""
        for remote in self._host.remotes:
            for running in remote.joined():
                bridge = running.bridge
                if isinstance(bridge, TopicBridge):
                    tap = self.tap(running.route)
                    if tap is not None or bridge.options.tap is not None:
                        await bridge.change(replace(bridge.options, tap=tap))
        wanted = any(recorder.running and _looks(recorder.config) for recorder in self._recorders.values())
        if wanted and self._looking is None:
            self._looking = Supervised(self._look_at_links, "recorders: links").start()
        elif not wanted and self._looking is not None:
            looking, self._looking = self._looking, None
            await end(looking)

    # ── links ──────────────────────────────────────────────────────────────────────────────────────────────────

    async def _look_at_links(self) -> None:
        from ropeway.gateway.recording.link_report import LinkReport

        report, loop = LinkReport(), asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            for remote in self._host.remotes:
                if remote not in self._told:
                    self._told.add(remote)
                    remote.on_state(self._changed.set)
            self._changed.clear()
            figures = loop.time() >= due_s
            if figures:
                due_s = loop.time() + _FIGURES_S
            messages, losses = report.look(self._host.remotes, figures=figures)
            if figures:
                messages += report.drops(self._host.remotes)
            for recorder in self._recorders.values():
                if recorder.running and recorder.config.link_state:
                    for message in messages:
                        recorder.put(message)
                if recorder.config.link_loss:
                    for loss in losses:
                        recorder.trigger(f"the link to {loss.link} is lost{f': {loss.why}' if loss.why else ''}")
            with suppress(TimeoutError):
                async with aio.timeout(_LOOK_S):
                    await self._changed.wait()


def _looks(config: RecordConfig) -> bool:
    return config.link_state or config.link_loss
