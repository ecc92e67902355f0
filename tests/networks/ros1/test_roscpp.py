"""Topics and services with a roscpp node, built from ``peer.cpp`` with Debian's libraries."""

from __future__ import annotations

import shutil
import subprocess
from pathlib import Path

import pytest

from ropeway.errors import CallFailed
from ropeway.graph.calls import Request
from tests.support.until import PATIENCE_S, until

from .conftest import Join
from .messages import STRING, Box, sample, text
from .network import RosMaster, running

SOURCE = Path(__file__).with_name("peer.cpp")


@pytest.fixture(scope="session")
def program(tmp_path_factory: pytest.TempPathFactory) -> str:
    """The compiled peer."""
    if shutil.which("g++") is None or shutil.which("pkg-config") is None:
        pytest.skip("needs a C++ compiler, which .ci/run installs on Debian")
    if not Path("/usr/include/std_srvs/SetBool.h").exists():
        pytest.skip("needs libroscpp-dev, libstd-msgs-dev and libstd-srvs-dev, which .ci/run installs on Debian")
    flags = subprocess.run(
        ["pkg-config", "--cflags", "--libs", "roscpp"], capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    out = str(tmp_path_factory.mktemp("peer") / "peer")
    subprocess.run(["g++", "-O0", "-o", out, str(SOURCE), *flags.stdout.split()], timeout=300, check=True)
    return out


@pytest.mark.timeout(360)
async def test_roscpp(master: RosMaster, join: Join, program: str) -> None:
    """Messages go to a roscpp node and come back, its service is called, and it calls ours."""
    graph, box = await join(), Box()

    async def ours(request: Request) -> bytes:
        if not request.payload[4]:
            raise CallFailed("/ours", "not now")
        return b"\0\1\0\0\1\0\0\0\3\0\0\0on\0"

    await graph.create_service("/ours", "std_srvs/srv/SetBool", ours)
    publisher = await graph.create_publisher("/there", STRING)
    subscription = await graph.create_subscription("/back", STRING, None, box)
    async with running(master, program) as peer:
        await peer.wait_for("ready")
        await until(lambda: publisher.subscribers == 1 and subscription.qos.transient_local)
        for number in range(50):
            publisher.publish(sample(text(f"message {number}")))
        await until(lambda: len(box.samples) == 50)
        assert box.texts[7] == "7 egassem"
        client = await graph.create_client("/flip", "std_srvs/srv/SetBool")
        assert await client.call(Request(b"\0\1\0\0\1")) == b"\0\1\0\0\0\0\0\0\7\0\0\0was on\0"
        with pytest.raises(CallFailed):
            await client.call(Request(b"\0\1\0\0\0"))
        for line in ("called 0 1 on", "called 1 0", "called 2 1 on"):
            await peer.wait_for(line)
        await until(lambda: graph.services()["/flip"].type == "std_srvs/srv/SetBool")
