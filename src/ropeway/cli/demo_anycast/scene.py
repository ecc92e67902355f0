"""Plays the demo: three machines as processes behind links with delays, and a robot that sends frames."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Callable, Sequence
from contextlib import AsyncExitStack
from dataclasses import dataclass, field
from typing import Any, Final

from ropeway import aio
from ropeway.cli.anycast.table import drawn, named
from ropeway.cli.demo.gateways import free_port
from ropeway.cli.demo_anycast.machine import ANSWER, FRAME
from ropeway.cli.demo_anycast.slow_link import SlowLink
from ropeway.control.control import Control
from ropeway.control.manager import Manager
from ropeway.errors import RopewayError
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.group import LinkGroupRemote
from ropeway.graph.base import Sample, new_origin
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry

__all__ = ["Story", "play"]

NAME: Final = "demo-anycast"
"""By which commands find the robot's gateway."""

LINKS_S: Final = {"edge1": 0.002, "edge2": 0.006, "cloud": 0.02}  # one way
SLOW_S: Final = 0.06  # more, each way
BOUND_S: Final = 0.08
FRAMES_HZ: Final = 30.0
FRAME_BYTES: Final = 20_000
DRAWN_EVERY: Final = 8  # frames
START_S: Final = 30.0
ANSWERS_S: Final = 1.0  # for the last answers


@dataclass
class Story:
    """The frames, when each was sent and how late it was answered, and by whom; changes, and when the link was slow."""

    sent_s: list[float] = field(default_factory=list)
    answers: dict[int, tuple[float, str]] = field(default_factory=dict)  # by frame: how late, and by whom
    changes: list[tuple[float, str, str]] = field(default_factory=list)
    slow_s: tuple[float, float] = (0.0, 0.0)
    slowed: str = ""

    def summary(self) -> dict[str, Any]:
        """Return what came of it; ``ok`` if another machine took over while the link was slow."""
        frames, answered = len(self.sent_s), len(self.answers)
        from_s, to_s = self.slow_s
        taken = next((name for at, name, _ in self.changes if from_s <= at <= to_s and name != self.slowed), None)
        return {
            "ok": taken is not None and answered >= 0.95 * frames,
            "frames": frames,
            "answered": answered,
            "late": sum(late_s > BOUND_S for late_s, _ in self.answers.values()),
            "slowed": self.slowed,
            "taken over by": taken,
        }


async def play(seconds: float, *, live: bool, say: Callable[[str], None]) -> Story:
    """Play for so long; a third of it the link to the machine in use is slow."""
    async with AsyncExitStack() as stack:
        say("starting a robot, two edges and a cloud")
        links: dict[str, SlowLink] = {}
        for name, delay_s in LINKS_S.items():
            port = free_port()
            await _machine(stack, name, port)
            link = links[name] = SlowLink(port, delay_s)
            await link.start()
            stack.push_async_callback(link.close)
        addresses = {name: f"ws://127.0.0.1:{link.port}" for name, link in links.items()}
        remote = {
            "title": "detectors",
            "address": list(addresses.values()),
            "anycast": {
                "stateless": True,
                "latency_bound": {"p90": BOUND_S},
                "responses": {"/camera": "/found"},
                "initial_policy": {"robot": "robot", **dict.fromkeys(addresses, "standby"), "edge1": "service"},
            },
            "publish": [{"name": "/camera", "type": FRAME}],
            "subscribe": [{"name": "/found", "type": ANSWER}],
        }
        settings = {"name": "robot", "graphs": ["memory:robot"], "listen": [], "control": {"name": NAME}}
        gateway = await stack.enter_async_context(Gateway(config.parse({"gateway": settings, "remotes": [remote]})))
        await _controlled(stack, gateway, say)
        group = gateway.remotes[0]
        assert isinstance(group, LinkGroupRemote)
        return await _drive(stack, group, links, {a: n for n, a in addresses.items()}, seconds, live=live)


async def _controlled(stack: AsyncExitStack, gateway: Gateway, say: Callable[[str], None]) -> None:
    """Let commands look at the group while it runs, and change it."""
    manager = Manager(gateway)
    stack.push_async_callback(manager.close)
    try:
        await stack.enter_async_context(Control(manager))
    except RopewayError as error:  # another demo runs here: this one goes on without
        say(f"commands do not reach this demo: {error}")
    else:
        say(f"to look at it from another terminal: ropeway anycast status {NAME} --watch")


async def _machine(stack: AsyncExitStack, name: str, port: int) -> None:
    words = [sys.executable, "-m", "ropeway.cli.demo_anycast.machine", name, str(port)]
    process = await asyncio.create_subprocess_exec(*words, stdout=asyncio.subprocess.PIPE)

    async def stop() -> None:
        if process.returncode is None:
            process.terminate()
        await process.wait()

    stack.push_async_callback(stop)
    assert process.stdout is not None
    async with aio.timeout(START_S):
        if not await process.stdout.readline():
            raise RopewayError(f"{name} did not start")


async def _drive(
    stack: AsyncExitStack,
    group: LinkGroupRemote,
    links: dict[str, SlowLink],
    names: dict[str, str],
    seconds: float,
    *,
    live: bool,
) -> Story:
    """Send frames, slow the link of the machine in use for the middle third, and note what comes of it."""
    registry, origin, story = TypeRegistry(), new_origin(), Story()
    frames, answers = registry.codec(FRAME), registry.codec(ANSWER)
    loop = asyncio.get_running_loop()
    node = MemoryGraph("robot", node="/camera")
    await node.open()
    stack.push_async_callback(node.close)
    camera = await node.create_publisher("/camera", FRAME)
    begins = loop.time()

    def came(batch: Sequence[Sample]) -> None:
        for sample in batch:
            header = answers.decode(sample.payload)["header"]
            number = header["stamp"]["nanosec"]
            story.answers[number] = (loop.time() - begins - story.sent_s[number], header["frame_id"])

    await node.create_subscription("/found", ANSWER, None, came)
    everybody = asyncio.Event()

    def look(_: int | bool) -> None:
        if len(group.graph.scheduler.here) == len(names) and camera.subscribers:
            everybody.set()

    camera.on_demand(look)
    for link in group.links.values():
        link.on_reached(look)
    async with aio.timeout(START_S):
        await everybody.wait()
    screen = _screen(stack) if live else None
    begins = loop.time()
    for number in range(int(seconds * FRAMES_HZ)):
        await asyncio.sleep(max(0.0, begins + number / FRAMES_HZ - loop.time()))
        at_s = loop.time() - begins
        if not story.slowed and at_s >= seconds / 3:
            story.slowed = names[group.current]
            story.slow_s = at_s, seconds
            links[story.slowed].delay_s += SLOW_S
        elif story.slowed and story.slow_s[1] == seconds and at_s >= 2 * seconds / 3:
            story.slow_s = story.slow_s[0], at_s
            links[story.slowed].delay_s -= SLOW_S
        story.sent_s.append(at_s)
        stamp = {"sec": 1, "nanosec": number}
        payload = frames.encode({"header": {"stamp": stamp}, "format": "jpeg", "data": bytes(FRAME_BYTES)})
        camera.publish(Sample(payload, FRAME, 1_000_000_000 + number, origin, number))
        if screen is not None and number % DRAWN_EVERY == 0:
            screen(group)
    await asyncio.sleep(ANSWERS_S)
    for decision in group.graph.scheduler.decisions:
        if decision.before != decision.after and decision.at_s >= begins:
            machine = names.get(decision.after, "nobody")
            story.changes.append((decision.at_s - begins, machine, named(decision.why, names)))
    return story


def _screen(stack: AsyncExitStack) -> Callable[[LinkGroupRemote], None]:
    from rich.console import Console
    from rich.live import Live

    console = Console()
    if not console.is_terminal:
        stack.callback(console.line)  # what is said next begins a line of its own
    screen = stack.enter_context(Live(console=console, auto_refresh=False))
    return lambda group: screen.update(drawn(group.commands.report()), refresh=True)
