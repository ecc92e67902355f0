"""Gateways between a network of ROS 2 Humble and one of ours, each on real DDS in one process."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway.gateway.config.config import parse
from ropeway.gateway.gateway import Gateway
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.graph.calls import Request
from ropeway.networks.dds import DdsGraph
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.isolation import isolated_dds
from tests.support.layouts import GO, LOOK, RANGE, drive_8_m, halves
from tests.support.until import until

_TEXTS = {
    "srv/Look.srv": "sensor_msgs/Range seen\n---\nsensor_msgs/Range found\n",
    "action/Go.action": "sensor_msgs/Range goal\n---\nsensor_msgs/Range end\n---\nsensor_msgs/Range way\n",
}
_OLDER = "sensor_msgs/Range goal\n---\nsensor_msgs/Range end\nuint8 code\n---\nsensor_msgs/Range way\n"


@pytest.fixture(autouse=True)
def dds_isolation() -> Iterator[None]:
    """The networks of this test are its own."""
    with isolated_dds():
        yield


@pytest.fixture
def files(tmp_path: Path) -> Path:
    """Definitions of services and actions, and an older version of one of them."""
    for name, text in {
        **{f"new/{name}": text for name, text in _TEXTS.items()},
        "old/action/Go.action": _OLDER,
    }.items():
        file = tmp_path / name.split("/")[0] / "my_msgs" / name.partition("/")[2]
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
    return tmp_path


async def _gateway(stack: AsyncExitStack, files: Path, graph: object, *remotes: dict[str, Any]) -> Gateway:
    document = {
        "gateway": {"name": f"g{len(remotes)}", "graphs": [graph], "types": ["new"], "listen": ["ws://127.0.0.1:0"]},
        "remotes": list(remotes),
    }
    return await stack.enter_async_context(Gateway(parse(document, directory=files)))


async def _node(stack: AsyncExitStack, domain: int, registry: TypeRegistry) -> DdsGraph:
    graph = DdsGraph(domain, name=f"node{domain}", interface="lo", registry=registry)
    await graph.open()
    stack.push_async_callback(graph.close)
    return graph


async def test_topics_services_and_actions_between_distributions(stack: AsyncExitStack, files: Path) -> None:
    """What a Humble robot publishes, serves and carries out is used in the cloud, each side in its own layouts."""
    theirs, ours = TypeRegistry("humble", alone=True), TypeRegistry()
    theirs.add_path(files / "new" / "my_msgs" / "srv")
    theirs.add_path(files / "old")
    ours.add_path(files / "new")
    robot, cloud = await _node(stack, 56, theirs), await _node(stack, 57, ours)
    server = await _gateway(stack, files, "dds:57?interface=lo")
    port = server.servers[0].listeners[0].port
    robots = await _gateway(
        stack,
        files,
        {"address": "dds:56?interface=lo", "distro": "humble", "types": ["old"]},
        {
            "address": f"ws://127.0.0.1:{port}",
            "publish": [{"name": "/range", "type": RANGE, "compression": "cbor-raw"}],
            "expose-service": [{"name": "/look", "type": LOOK}],
            "expose-action": [{"name": "/go", "type": GO}],
        },
    )
    assert [gateway.status()["graphs"][0].get("distro") for gateway in (robots, server)] == ["humble", None]
    api = robots.servers[0].rosapi
    assert api is not None
    assert await api.call("/rosapi/get_ros_version") == {"version": 2, "distro": "humble"}
    fed: list[float] = []

    async def look(request: Request) -> bytes:
        seen = theirs.codec(f"{LOOK}_Request").decode(request.payload)["seen"]
        return theirs.codec(f"{LOOK}_Response").encode({"found": {"range": seen["range"] + 1}})

    await robot.create_service("/look", LOOK, look)
    await robot.create_action_server("/go", GO, halves(theirs, fed, code=7))
    inbox = Inbox()
    await cloud.create_subscription("/range", RANGE, None, inbox)
    publisher = await robot.create_publisher("/range", RANGE)
    await until(lambda: publisher.subscribers == 1, 20)
    raw = theirs.codec(RANGE).encode({"range": 1.25})
    publisher.publish(Sample(raw, RANGE, 1, new_origin(), SEQ_NONE))
    assert ours.codec(RANGE).decode((await inbox.wait(1))[0].payload)["range"] == 1.25

    client = await cloud.create_client("/look", LOOK)
    assert await client.wait_available(20)
    answer = await client.call(Request(ours.codec(f"{LOOK}_Request").encode({"seen": {"range": 2.0}})), 20)
    assert ours.codec(f"{LOOK}_Response").decode(answer)["found"]["range"] == 3.0

    user = await cloud.create_action_client("/go", GO)
    await drive_8_m(user, ours, fed, 20)
