"""A robot of ROS 1, for the demo: a node of rospy that moves by /cmd_vel and prints its track when it is ended."""

import json
import math
import signal
import sys
import time

import rospy
from geometry_msgs.msg import Twist

HOLD_S = 0.5


def main() -> None:
    """Move until ended."""
    state = {"speed": 0.0, "turn": 0.0, "until": 0.0, "end": False}

    def heard(message: "Twist") -> None:
        state.update(speed=message.linear.x, turn=message.angular.z, until=time.monotonic() + HOLD_S)

    def ended(*_: object) -> None:
        state["end"] = True

    rospy.init_node("turtle", disable_signals=True)
    signal.signal(signal.SIGTERM, ended)
    rospy.Subscriber("/cmd_vel", Twist, heard, queue_size=1, tcp_nodelay=True)
    print("ready", flush=True)
    x = y = heading = 0.0
    track = []
    began = before = time.monotonic()
    while not state["end"]:
        time.sleep(0.02)
        now = time.monotonic()
        step = min(now, max(state["until"], before)) - before
        heading += state["turn"] * step
        x += state["speed"] * step * math.cos(heading)
        y += state["speed"] * step * math.sin(heading)
        track.append((round(now - began, 3), round(x, 4), round(y, 4), round(heading, 4)))
        before = now
    print(json.dumps(track), flush=True)
    sys.stdout.close()


if __name__ == "__main__":
    main()
