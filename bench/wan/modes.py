"""What carries the topics over the link: a pair of gateways, the overlay, a server with a client, or a peer of ours."""

from __future__ import annotations

import json
import shlex
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from bench.netns import Process
from bench.wan.ends import Topic
from bench.wan.link import FAR, NEAR, Link
from ropeway.networks.overlay.crypto.identity import write_private
from ropeway.networks.overlay.fleet import Fleet

__all__ = ["ENCODINGS", "MODES", "Carrier", "start"]

ENCODINGS = ("auto", "none", "cbor", "cbor-raw", "png", "zip", "rawzip", "zstd")
MODES = (
    *ENCODINGS,
    "overlay",
    "overlay-routed",
    "client:none",
    "client:cbor",
    "client:cbor-raw",
    "peer",
    "local",
)

_PORT, _ROUTER_PORT = 9090, 7447


@dataclass
class Carrier:
    """The processes that carry the topics, and how the far end reads them."""

    near: Process | None
    far: Process | None
    client: str | None = None
    """The compression that a rosbridge client asks for, where it reads in place of a node on DDS."""
    local: bool = False
    """The sink is at the source's end: nothing crosses the link."""


def start(
    link: Link, directory: Path, mode: str, pair: int, up: list[Topic], down: list[Topic], commands: tuple[str, str]
) -> Carrier:
    """Start what carries ``up`` from the near end to the far one and ``down`` back, as the ``pair``-th of its kind."""
    if mode == "local":
        return Carrier(None, None, local=True)
    if mode == "peer":
        return Carrier(*(_command(link, end, text) for end, text in zip(("near", "far"), commands, strict=True)))
    graph = f"dds:{pair}?interface=lo"
    if mode.startswith("client:"):
        words = ("-m", "ropeway", "server", "--graph", graph, "--address", NEAR, "--port", str(_PORT + pair))
        return Carrier(link.start("near", *words, "--insecure", "--quiet"), None, client=mode.partition(":")[2])
    if mode.startswith("overlay"):
        return _overlay(link, directory, graph, pair, mode == "overlay-routed", up, down)
    address = f"ws://{FAR}:{_PORT + pair}"
    far = {"name": f"far{pair}", "graphs": [graph], "listen": [address], "insecure": True}
    near = {"name": f"near{pair}", "graphs": [graph], "listen": []}
    remote = {"address": address, "publish": _items(up, mode), "subscribe": _items(down, mode)}
    return Carrier(
        _run(link, "near", directory, {"gateway": near, "remotes": [remote]}),
        _run(link, "far", directory, {"gateway": far, "remotes": []}),
    )


def _items(topics: list[Topic], encoding: str | None) -> list[dict[str, Any]]:
    more = {"compression": encoding} if encoding else {}
    return [{"name": topic.name, "type": topic.type, **more} for topic in topics]


def _run(link: Link, end: str, directory: Path, configuration: dict[str, Any]) -> Process:
    path = directory / f"{configuration['gateway']['name']}.json"
    path.write_text(json.dumps(configuration))
    return link.start(end, "-m", "ropeway", "run", str(path), "--quiet")


def _overlay(
    link: Link, directory: Path, graph: str, pair: int, routed: bool, up: list[Topic], down: list[Topic]
) -> Carrier:
    """A router at the far end, as in a cloud; gateways that may link directly, or only over it."""
    endpoint = f"tls/{FAR}:{_ROUTER_PORT + pair}"
    fleet = Fleet.create(f"wan{pair}", directory / f"fleet{pair}")
    names = {end: f"{end}{pair}" for end in ("near", "far", "router")}
    for end, name in names.items():
        bundle = fleet.issue(name, role="router" if end == "router" else "member")
        write_private(directory / f"{name}.ropeway", bundle.to_text())
    identity = str(directory / f"{names['router']}.ropeway")
    link.start("far", "-m", "ropeway", "router", "-i", identity, "-l", endpoint, "--json").line()
    running = []
    for end, publish, subscribe in (("near", up, down), ("far", down, up)):
        member = {"identity": str(directory / f"{names[end]}.ropeway"), "routers": [endpoint]}
        listen = {"listen": []} if routed else {}
        remote = {"address": "overlay", "publish": _items(publish, None), "subscribe": _items(subscribe, None)}
        gateway = {"name": names[end], "graphs": [graph], "listen": [], "overlay": {**member, **listen}}
        running.append(_run(link, end, directory, {"gateway": gateway, "remotes": [remote]}))
    return Carrier(*running)


def _command(link: Link, end: str, text: str) -> Process:
    """Start a peer's command, with ``{near}`` and ``{far}`` replaced by the addresses of the ends."""
    words = [word.format(near=NEAR, far=FAR) for word in shlex.split(text)]
    hand_over = "import os, sys; os.execvp(sys.argv[1], sys.argv[1:])"  # the process is the peer's, and so is its CPU
    return link.start(end, "-c", hand_over, *words)
