"""``ropeway demo-anycast``: a robot that is answered by the best of three machines."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path

import pytest

from ropeway.cli.demo_anycast.drawing import draw
from ropeway.cli.demo_anycast.scene import Story
from ropeway.cli.demo_anycast.slow_link import SlowLink
from tests.cli.conftest import Ropeway


@pytest.mark.slow
@pytest.mark.timeout(120)
def test_another_machine_takes_over(ropeway: Ropeway, tmp_path: Path) -> None:
    """When the link to the machine in use becomes slow another takes over, and the latencies are drawn."""
    output = tmp_path / "anycast.png"
    done = ropeway("demo-anycast", "--json", "--for", "9", "--output", str(output), timeout_s=90)
    assert done.returncode == 0, done.stdout + done.stderr
    told = json.loads(done.stdout)
    assert told["ok"] and told["taken over by"] != told["slowed"]
    assert output.read_bytes().startswith(b"\x89PNG")


def test_summary(tmp_path: Path) -> None:
    """A story in which nobody took over while the link was slow is not taken for right, and is drawn all the same."""
    story = Story([0.0, 0.1, 0.2], {0: (0.01, "edge1"), 1: (0.2, "edge1"), 2: (0.01, "edge2")}, slow_s=(0.05, 0.15))
    story.slowed = "edge1"
    story.changes = [(0.18, "edge2", "late")]
    assert not story.summary()["ok"]
    assert (story.summary()["late"], story.summary()["answered"]) == (1, 3)
    story.changes = [(0.1, "edge2", "in time")]
    assert story.summary()["ok"]
    assert draw(story, tmp_path / "x.png")


async def test_a_slow_link() -> None:
    """What goes over a slow link arrives whole and in order, both ways, and the end of one side is the other's."""

    async def echo(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        while data := await reader.read(1000):
            writer.write(data)
        writer.close()

    server = await asyncio.start_server(echo, "127.0.0.1", 0)
    link = SlowLink(server.sockets[0].getsockname()[1], 0.001)
    await link.start()
    reader, writer = await asyncio.open_connection("127.0.0.1", link.port)
    sent = bytes(range(256)) * 100
    writer.write(sent)
    assert await reader.readexactly(len(sent)) == sent
    writer.write_eof()
    assert await reader.read() == b""
    writer.close()
    await link.close()
    server.close()
