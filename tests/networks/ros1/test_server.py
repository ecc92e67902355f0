"""A rosbridge server on a ROS 1 network."""

from __future__ import annotations

import json

import pytest

from ropeway.graph.calls import Request
from ropeway.hub.hub import Hub
from ropeway.listener.globs import Globs
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.networks.rosbridge.rosapi import Rosapi
from ropeway.networks.rosbridge.server import RosbridgeServer
from ropeway.qos import QoS
from tests.support.until import PATIENCE_S, until

from .conftest import Join
from .messages import STRING, Box, sample, text
from .network import HAS_ROSPY, RosMaster, rospy

pytestmark = pytest.mark.skipif(not HAS_ROSPY, reason="needs rospy, which .ci/run installs on Debian")

PEER = """
import rospy
from std_msgs.msg import String
from std_srvs.srv import SetBool, SetBoolResponse
rospy.init_node("peer")
back = rospy.Publisher("/back", String, queue_size=10, latch=True)
rospy.Subscriber("/there", String, lambda m: back.publish(m.data[::-1]))
rospy.Service("/switch", SetBool, lambda r: SetBoolResponse(True, "on"))
rospy.spin()
"""


async def test_rosbridge(master: RosMaster, join: Join) -> None:
    """A client of the server talks to ROS 1 nodes, and finds what they have."""
    graph = await join("server")
    server = RosbridgeServer(Hub(graph), graph.registry)
    listener = await server.listen("ws://127.0.0.1:0")
    client = RosbridgeGraph(f"ws://127.0.0.1:{listener.port}", registry=graph.registry)
    await client.open()
    box = Box()
    try:
        async with rospy(master, PEER):
            publisher = await client.create_publisher("/there", STRING)
            await client.create_subscription("/back", STRING, QoS(), box)
            await until(lambda: publisher.subscribers)
            publisher.publish(sample(text("abc")))
            await until(lambda: box.texts == ["cba"])
            switch = await client.create_client("/switch", "std_srvs/srv/SetBool")
            assert await switch.wait_available(PATIENCE_S)
            assert (await switch.call(Request(b"\0\1\0\0\1")))[4] == 1
            await until(lambda: client.topics()["/back"].type == STRING and "/peer" in client.nodes())
    finally:
        await client.close()
        await server.close()


async def test_parameters(master: RosMaster, join: Join) -> None:
    """Rosapi reads, sets, lists and deletes the parameters of the master."""
    graph = await join("server")
    rosapi = Rosapi(Hub(graph), graph.registry, globs=Globs(params=("/robot/*",)))
    try:
        await graph.set_param("/secret", 1)
        assert await rosapi.call("/rosapi/set_param", {"name": "/robot/speed", "value": "0.5"})
        await rosapi.call("/rosapi/set_param", {"name": "robot/names", "value": '["a", "b"]'})
        assert await graph.get_param("/robot/speed") == 0.5
        found = await rosapi.call("/rosapi/get_param", {"name": "/robot/names", "default_value": ""})
        assert json.loads(found["value"]) == ["a", "b"]
        assert (await rosapi.call("/rosapi/get_param_names"))["names"] == ["/robot/names", "/robot/speed"]
        missing = await rosapi.call("/rosapi/get_param", {"name": "/robot/x", "default_value": "7"})
        assert missing["value"] == "7"
        hidden = await rosapi.call("/rosapi/get_param", {"name": "/secret", "default_value": ""})
        assert "glob" in hidden["reason"]
        assert (await rosapi.call("/rosapi/has_param", {"name": "/robot/speed"}))["exists"]
        await rosapi.call("/rosapi/delete_param", {"name": "/robot/speed"})
        assert not (await rosapi.call("/rosapi/has_param", {"name": "/robot/speed"}))["exists"]
    finally:
        await rosapi.close()
