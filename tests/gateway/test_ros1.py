"""A gateway that stands on a ROS 1 network."""

from __future__ import annotations

import asyncio
from pathlib import Path

import pytest

from ropeway import aio
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from tests.networks.ros1.network import HAS_ROSPY, RosMaster, rospy
from tests.support.inbox import Inbox
from tests.support.messages import STRING, joined, sample, text
from tests.support.until import PATIENCE_S, until

pytestmark = pytest.mark.skipif(not HAS_ROSPY, reason="needs rospy, which .ci/run installs on Debian")

ECHO = """
import rospy
from std_msgs.msg import String
rospy.init_node("echo")
out = rospy.Publisher("/answer", String, queue_size=10)
rospy.Subscriber("/question", String, lambda m: out.publish(m.data.upper()))
rospy.spin()
"""


async def test_across(tmp_path: Path) -> None:
    """A gateway that is started before its master joins a ROS 1 network with another, and what is said crosses."""
    registry = TypeRegistry()
    master = RosMaster(tmp_path)
    cloud = {"gateway": {"name": "cloud", "graphs": ["memory:ros1-cloud"], "listen": ["ws://127.0.0.1:0"]}}
    far = MemoryGraph("ros1-cloud", node="/person")
    await far.open()
    async with Gateway(config.parse(cloud), registry=registry) as server:
        port = server.servers[0].listeners[0].port
        remote = {
            "address": f"ws://127.0.0.1:{port}",
            "publish": [{"name": "/answer", "type": STRING}],
            "subscribe": [{"name": "/question", "type": STRING}],
        }
        robot = {"gateway": {"name": "robot", "graphs": [f"ros1:{master.uri}"], "listen": []}, "remotes": [remote]}
        gateway = Gateway(config.parse(robot), registry=registry)
        entering = asyncio.create_task(gateway.__aenter__())
        try:
            await asyncio.sleep(0.2)
            assert not entering.done()
            await asyncio.to_thread(master.start)
            async with aio.timeout(PATIENCE_S):
                await entering
            async with rospy(master, ECHO):
                inbox = Inbox()
                await far.create_subscription("/answer", STRING, QoS(), inbox)
                question = await far.create_publisher("/question", STRING)
                await joined(question)
                await until(lambda: [row["state"] for row in gateway.status()["routes"]] == ["active", "active"])

                def answered() -> bool:
                    question.publish(sample("hello"))
                    return bool(inbox.samples)

                await until(answered)
                assert inbox.payloads[0] == text("HELLO")
            await gateway.__aexit__()
        finally:
            entering.cancel()
            master.kill()
            await far.close()
