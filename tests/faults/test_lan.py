"""Local servers of nodes, found by other machines of their network."""

from __future__ import annotations

import asyncio
import sys
from asyncio.subprocess import PIPE, Process
from collections.abc import Awaitable, Callable
from contextlib import AsyncExitStack

import pytest

from ropeway import aio
from tests.faults.conftest import ROOT, Pair, ip
from tests.support.until import PATIENCE_S

pytestmark = [pytest.mark.netns, pytest.mark.slow, pytest.mark.timeout(3 * PATIENCE_S)]

MakePair = Callable[[], Awaitable[Pair]]
_NODE = """
import asyncio, sys
from ropeway.iort import AsyncNode

async def main():
    token, cloud = sys.argv[1:]
    async with AsyncNode("PEPPER", cloud, token=token, discover=True) as node:
        print(node.mode if not await node.wait_mode("local-server", 8) else "found", flush=True)
        if node.mode == "local-server":
            await node.publish("battery", "80")
            print((await node.read("battery")).mode, flush=True)

asyncio.run(main())
"""


async def _run(stack: AsyncExitStack, namespace: str, *command: str) -> Process:
    process = await asyncio.create_subprocess_exec(
        "ip", "netns", "exec", namespace, sys.executable, *command, cwd=ROOT, stdout=PIPE, stderr=PIPE
    )

    async def end() -> None:
        if process.returncode is None:
            process.kill()
        await process.communicate()

    stack.push_async_callback(end)
    return process


async def _said(process: Process) -> list[str]:
    async with aio.timeout(PATIENCE_S):
        out, errors = await process.communicate()
    assert process.returncode == 0, errors.decode()
    return out.decode().split()


@pytest.mark.parametrize("network", ["routed", "without a route", "without multicast"])
async def test_found_by_another_machine(stack: AsyncExitStack, pair: MakePair, network: str) -> None:
    """A node finds the server of its fleet on another machine, also on a network that leads nowhere else."""
    both = await pair()
    for namespace, own, other in ((both.a, both.address_a, both.address_b), (both.b, both.address_b, both.address_a)):
        if network == "routed":
            ip(f"-n {namespace} route add default via {other}")
        if network == "without multicast":
            ip(f"-n {namespace} link set wire multicast off")
            ip(f"-n {namespace} addr change {own}/24 brd + dev wire")
    serve = ("-m", "ropeway.iort", "--serve", "0.0.0.0:7410", "--announce", "--token", "fleet", "--called", "base")
    server = await _run(stack, both.a, *serve)
    assert server.stdout is not None
    async with aio.timeout(PATIENCE_S):
        assert b"7410" in await server.stdout.readline()
    cloud = f"iort://{both.address_b}:7499"  # where nobody is
    member, stranger = [await _run(stack, both.b, "-c", _NODE, token, cloud) for token in ("fleet", "other")]
    assert await _said(member) == ["found", "local-server"]
    assert await _said(stranger) == ["local"]
