"""Use a rosbridge server or gateway as a client: python examples/rosbridge_client.py ws://robot:9090 [token]."""

import asyncio
import sys

import ropeway


async def main(url: str, token: str = "") -> None:
    """Publish and call over one WebSocket; a lost connection is made again by itself."""
    headers = {"Authorization": f"Bearer {token}"} if token else None
    async with (
        ropeway.open(url, headers=headers) as robot,
        robot.publisher("/cmd_vel", "geometry_msgs/Twist", delivery=ropeway.Delivery(priority=0)) as commands,
    ):
        commands.publish({"linear": {"x": 0.2}})
        answer = await robot.call("/rosapi/topics", type="rosapi_msgs/Topics")
        for topic, type in zip(answer["topics"], answer["types"], strict=True):
            print(topic, type)


asyncio.run(main(*sys.argv[1:3]))
