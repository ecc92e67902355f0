"""Run a gateway from a dict and show how its routes stand: python examples/gateway.py [seconds]."""

import sys
import time

from ropeway import blocking

CLOUD = {"gateway": {"name": "cloud", "graphs": ["memory:cloud"], "listen": ["ws://127.0.0.1:0"]}}

with blocking.open_gateway(CLOUD) as cloud:
    robot = {
        "gateway": {"name": "robot", "graphs": ["memory:robot"]},
        "remotes": [
            {
                "address": f"ws://127.0.0.1:{cloud.ports[0]}",
                "publish": [{"name": "/odom", "type": "nav_msgs/msg/Odometry", "rate_hz": 20}],
                "subscribe": [{"name": "/cmd_vel", "type": "geometry_msgs/msg/Twist", "priority": "command"}],
            }
        ],
    }
    with blocking.open_gateway(robot) as gateway:
        for _ in range(int(sys.argv[1]) if len(sys.argv) > 1 else 10):
            time.sleep(1)
            for route in gateway.status()["routes"]:
                print(route["operation"], route["name"], route["state"])
