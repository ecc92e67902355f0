"""``ropeway topic pub``: publish a message, once or at a rate."""

from __future__ import annotations

import asyncio
import time
from collections.abc import Callable
from typing import Annotated, Any, Final

import typer

from ropeway import aio
from ropeway.cli.console import answer, complain, fail, print_json
from ropeway.cli.loop import run
from ropeway.cli.refusal import taken, unless_refused
from ropeway.cli.session import (
    GraphOption,
    JsonOption,
    OpenGraph,
    QosDepth,
    QosDurability,
    QosHistory,
    QosProfile,
    QosReliability,
    TypesOption,
    open_session,
    qos_of,
    topic_name,
)
from ropeway.cli.topic.render import Style, as_python
from ropeway.cli.values import fitted, typed_values
from ropeway.graph.base import SEQ_NONE, Publisher, Sample, new_origin
from ropeway.qos import QoS

__all__ = ["app", "publish"]

app = typer.Typer(add_completion=False)
_TELL_S: Final = 1.0


async def publish(
    session: OpenGraph,
    topic: str,
    type: str,
    values: dict[str, Any],
    qos: QoS | None = None,
    *,
    rate_hz: float = 1.0,
    times: int | None = None,
    wait: int = 0,
    wait_s: float | None = None,
    keep_alive_s: float = 0.1,
    told: Callable[[int, bytes], None] = lambda number, payload: None,
) -> int:
    """Publish ``times`` times (for ever without) at an even pace; returns how often.

    First waits until ``wait`` subscribers are there, at most ``wait_s`` seconds. Raises ``ValueMismatch`` for values
    that do not fit, before anything is sent.
    """
    codec = session.registry.codec(type)
    values = fitted(session.registry, type, values)
    publisher = await session.graph.create_publisher(topic, codec.type, qos)
    try:
        with unless_refused(session.graph, publisher):
            await taken(session.graph, publisher)
            await _subscribers(publisher, wait, wait_s)
            sent = await _send(publisher, lambda: codec.from_json(values), rate_hz, times, told)
            await asyncio.sleep(keep_alive_s)  # what is on its way still needs its sender
    finally:
        await publisher.close()
    return sent


async def _send(
    publisher: Publisher,
    make: Callable[[], bytes],
    rate_hz: float,
    times: int | None,
    told: Callable[[int, bytes], None],
) -> int:
    loop = asyncio.get_running_loop()
    due = loop.time()
    origin = new_origin()
    sent = 0
    while times is None or sent < times:
        now_ns = time.time_ns()
        payload = make()
        publisher.publish(Sample(payload, publisher.type, now_ns, origin, SEQ_NONE))
        sent += 1
        told(sent, payload)
        due += 1.0 / rate_hz
        if times is None or sent < times:
            await asyncio.sleep(max(due - loop.time(), 0))
    return sent


async def _subscribers(publisher: Publisher, wanted: int, wait_s: float | None) -> None:
    if not wanted or publisher.subscribers is None:
        return
    enough = asyncio.Event()

    def changed(count: int) -> None:
        if count >= wanted:
            enough.set()

    publisher.on_demand(changed)
    loop = asyncio.get_running_loop()
    deadline = None if wait_s is None else loop.time() + wait_s
    while not enough.is_set():
        left = _TELL_S if deadline is None else min(deadline - loop.time(), _TELL_S)
        if left <= 0:
            fail(
                f"Timed out waiting for subscribers of {publisher.topic}: "
                f"expected {wanted}, there are {publisher.subscribers or 0}"
            )
        complain(f"Waiting for at least {wanted} matching subscription(s)...")
        try:
            async with aio.timeout(left):
                await enough.wait()
        except TimeoutError:
            continue


@app.command("pub")
def pub(
    topic: Annotated[str, typer.Argument(help="The topic, such as /chatter.", show_default=False)],
    type: Annotated[str, typer.Argument(help="Its type, such as std_msgs/msg/String.", show_default=False)],
    values: Annotated[str, typer.Argument(help="The fields in YAML, such as '{data: hi}'.")] = "{}",
    graph: GraphOption = "",
    stdin: Annotated[bool, typer.Option("--stdin", help="Read the values from standard input.")] = False,
    rate: Annotated[float, typer.Option("--rate", "-r", min=1e-6, help="Messages per second.")] = 1.0,
    print_every: Annotated[int, typer.Option("--print", "-p", min=0, help="Print every N-th message; 0: none.")] = 1,
    once: Annotated[bool, typer.Option("--once", "-1", help="Publish one message and end.")] = False,
    times: Annotated[
        int, typer.Option("--times", "-t", min=0, help="Publish this many times and end; 0: forever.")
    ] = 0,
    wait: Annotated[
        int | None,
        typer.Option(
            "--wait-matching-subscriptions",
            "-w",
            min=0,
            help="Wait for this many subscribers; 1 with --once and --times, 0 without.",
            show_default=False,
        ),
    ] = None,
    max_wait: Annotated[
        float, typer.Option("--max-wait-time-secs", min=0.0, help="Seconds to wait at most; 0: forever.")
    ] = 0.0,
    keep_alive: Annotated[float, typer.Option("--keep-alive", min=0.0, help="Seconds to stay after the last.")] = 0.1,
    qos_profile: QosProfile = "",
    qos_depth: QosDepth = None,
    qos_history: QosHistory = "",
    qos_reliability: QosReliability = "",
    qos_durability: QosDurability = "",
    types: TypesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Publish to TOPIC. The time "now", and "header: auto", mean the time of sending."""
    if once and times:
        fail("--once and --times exclude each other; give one", 2)
    name = topic_name(topic)
    qos = qos_of(qos_profile, qos_depth, qos_history, qos_reliability, qos_durability)
    fields = typed_values(values, stdin=stdin)
    limit = 1 if once else times or None

    async def main() -> None:
        async with open_session(graph, types) as session:
            full = session.registry.canonical(type)
            await session.know(full)
            codec = session.registry.codec(full)

            def told(number: int, payload: bytes) -> None:
                if not print_every or number % print_every:
                    return
                if as_json:
                    print_json({"topic": name, "number": number, "bytes": len(payload)})
                else:
                    message = as_python(session.registry, full, codec.decode(payload), Style())
                    answer(f"publishing #{number}: {message}\n")

            if not as_json:
                answer("publisher: beginning loop")
            await publish(
                session,
                name,
                full,
                fields,
                qos,
                rate_hz=rate,
                times=limit,
                wait=wait if wait is not None else int(limit is not None),
                wait_s=max_wait or None,
                keep_alive_s=keep_alive,
                told=told,
            )

    run(main())
