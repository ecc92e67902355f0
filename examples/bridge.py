"""Join a topic and a service of two networks within this process: python examples/bridge.py."""

import asyncio

import ropeway


async def main() -> None:
    """Let a "robot" and a "cloud" that cannot hear each other share what the bridge names, and nothing else."""
    async with (
        ropeway.open("memory:robot") as robot,
        ropeway.open("memory:cloud") as cloud,
        ropeway.open_bridge("memory:robot", "memory:cloud") as bridge,
        robot.publisher("/battery", "std_msgs/Float32", qos="latched") as battery,
        cloud.serve("/plan", "std_srvs/Trigger", lambda request: {"success": True, "message": "go left"}),
    ):
        await bridge.topic("/battery")
        await bridge.service("/plan", reverse=True)

        battery.publish({"data": 0.75})
        async with cloud.subscribe("/battery") as readings:
            print("the cloud reads", (await readings.receive())["data"])
        print("the robot is told:", (await robot.call("/plan"))["message"])
        for row in bridge.status():
            print(row["kind"], row["name"], row["state"])


asyncio.run(main())
