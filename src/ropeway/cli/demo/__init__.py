"""``ropeway demo``: two networks on one machine, joined by two gateways, with figures."""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import sys
import tempfile
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Annotated, Any, Final

import typer

from ropeway.cli.console import answer, complain, print_json
from ropeway.cli.demo.flow import Tally
from ropeway.cli.demo.gateways import GatewayProcess, configurations, dashboard, figures, free_port, running
from ropeway.cli.demo.scene import DemoTopic, recorded_parts, synthetic_parts
from ropeway.cli.demo.table import brief, live_table, summary_table
from ropeway.cli.loop import run
from ropeway.errors import RopewayError
from ropeway.extras import require
from ropeway.graph.base import Graph
from ropeway.networks import open_graph
from ropeway.processor_queue import patience
from ropeway.types import TypeRegistry

__all__ = ["app"]

app = typer.Typer(add_completion=False)
_FOR_S: Final = 15.0
_REFRESH_S: Final = 0.25
_FIRST_LINE_S: Final = 1.0  # the figures are of a second
_LINE_S: Final = 5.0
_CONNECT_S: Final = 20.0  # in which the robot's gateway had a processor
_LAST_S: Final = 0.5


@app.command("demo")
def demo(
    bag: Annotated[
        Path | None, typer.Option("--bag", help="Send a recording's camera and odometry.", show_default=False)
    ] = None,
    for_s: Annotated[
        float | None,
        typer.Option(
            "--for", min=1.0, help="Seconds to run; default: 15, with --web until Ctrl-C.", show_default=False
        ),
    ] = None,
    web: Annotated[bool, typer.Option("--web", help="Show it in a browser, on the dashboard.")] = False,
    domains: Annotated[tuple[int, int], typer.Option("--domains", help="The DDS domains of robot and cloud.")] = (
        71,
        72,
    ),
    as_json: Annotated[bool, typer.Option("--json", help="Print only the summary, as JSON.")] = False,
) -> None:
    """Join two DDS networks of this machine and show what crosses; exit status 0 if every route carried messages."""
    if web:
        require("dashboard", "ropeway demo --web")
    seconds = for_s or (None if web else _FOR_S)
    flows, told = run(_demo(bag, seconds, domains, shown=not as_json, web=web))
    ok = all(flow.arrived for flow in flows)
    if as_json:
        rows = [
            {
                **flow.summary(),
                "encoding": told.get(flow.topic, {}).get("encoding"),
                "drops": told.get(flow.topic, {}).get("drops", {}),
            }
            for flow in flows
        ]
        print_json({"ok": ok, "routes": rows})
    else:
        from rich.console import Console

        Console().print(summary_table(flows, told))
        silent = ", ".join(flow.topic for flow in flows if not flow.arrived)
        answer(f"Nothing arrived on {silent}." if silent else "Messages arrived on every route.")
    raise typer.Exit(0 if ok else 1)


async def _demo(
    bag: Path | None, for_s: float | None, domains: tuple[int, int], *, shown: bool, web: bool
) -> tuple[list[Tally], dict[str, dict[str, Any]]]:
    registry = TypeRegistry()
    parts = recorded_parts(registry, bag) if bag else synthetic_parts(registry)
    flows = [Tally(p.topic, p.type, p.side, registry.codec(p.type).header_stamp_ns) for p in parts]
    robot_url, cloud_url = (f"dds:{domain}?interface=127.0.0.1" for domain in domains)
    configs = configurations(parts, robot_url, cloud_url, free_port())
    stop = asyncio.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        asyncio.get_running_loop().add_signal_handler(number, stop.set)
    if shown:
        complain(f"Starting two gateways, on the DDS domains {domains[0]} (the robot's) and {domains[1]} (the cloud's)")
    with tempfile.TemporaryDirectory(prefix="ropeway-demo-") as directory:
        async with running(configs, Path(directory)) as gateways:
            graphs: dict[str, Graph] = {}
            try:
                for side, url in (("robot", robot_url), ("cloud", cloud_url)):
                    graphs[side] = await open_graph(url, registry=registry, name=f"{side}_{os.getpid()}")
                async with dashboard() if web else contextlib.nullcontext():
                    await _cross(parts, flows, graphs, gateways, for_s, stop, shown=shown)
            finally:
                for graph in graphs.values():
                    await graph.close()
            told = figures(gateways)
    return flows, told


async def _cross(
    parts: Iterable[DemoTopic],
    flows: list[Tally],
    graphs: Mapping[str, Graph],
    gateways: Mapping[str, GatewayProcess],
    for_s: float | None,
    stop: asyncio.Event,
    *,
    shown: bool,
) -> None:
    """Send every part on its side and listen on the other, until the time is over or ``stop`` is set."""
    other = {"robot": "cloud", "cloud": "robot"}
    for flow in flows:
        await graphs[other[flow.side]].create_subscription(flow.topic, flow.type, None, flow.on_batch)
    stopped = asyncio.create_task(stop.wait(), name="signals")
    watching = [asyncio.create_task(gateway.listen(), name=gateway.name) for gateway in gateways.values()]
    connected = asyncio.create_task(gateways["robot"].connected(), name="connected")
    sending: list[asyncio.Task[Any]] = []
    try:
        try:
            async with patience(_CONNECT_S, lambda: gateways["robot"].process.pid):
                await _first([connected], stopped, watching, None)
        except TimeoutError:
            raise RopewayError(f"the gateways did not find each other within {_CONNECT_S:g} s") from None
        if not connected.done():
            return
        sending = [
            asyncio.create_task(part.send(graphs[part.side], flow.on_sent), name=part.topic)
            for part, flow in zip(parts, flows, strict=True)
        ]
        showing = asyncio.create_task(_show(flows, gateways, shown=shown), name="table")
        sending.append(showing)
        await _first([], stopped, [*watching, *sending], for_s)
        for task in sending:
            task.cancel()
        await asyncio.sleep(_LAST_S)  # what is on its way still counts
    finally:
        tasks = [stopped, connected, *watching, *sending]
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)


async def _first(
    wanted: Iterable[asyncio.Task[Any]],
    stopped: asyncio.Task[Any],
    lasting: Iterable[asyncio.Task[Any]],
    timeout_s: float | None,
) -> None:
    """Wait for what is wanted, the end, or ``timeout_s``; what should last but has ended raises its error."""
    lasting = list(lasting)
    done, _ = await asyncio.wait([*wanted, stopped, *lasting], timeout=timeout_s, return_when=asyncio.FIRST_COMPLETED)
    for task in lasting:
        if task in done:
            await task


async def _show(flows: list[Tally], gateways: Mapping[str, GatewayProcess], *, shown: bool) -> None:
    """Show the live table, or print a line now and then if there is no terminal, until cancelled."""
    loop = asyncio.get_running_loop()
    began = loop.time()
    if shown:
        complain("They are connected; robot and cloud begin to send")
    if not shown or not sys.stdout.isatty():
        pause_s = _FIRST_LINE_S
        while True:
            await asyncio.sleep(pause_s)
            pause_s = _LINE_S
            if shown:
                complain(brief(flows, loop.time() - began))
    from rich.live import Live

    with Live(refresh_per_second=1 / _REFRESH_S, transient=True) as live:
        while True:
            live.update(live_table(flows, figures(gateways), loop.time() - began))
            await asyncio.sleep(_REFRESH_S)
