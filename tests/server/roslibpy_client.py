"""A roslibpy program: publishes on /from_client, prints what comes on /to_client as JSON lines, ends on a line."""

from __future__ import annotations

import json
import sys
import threading

import roslibpy


def main() -> None:
    host, port = sys.argv[1], int(sys.argv[2])
    ros = roslibpy.Ros(host=host, port=port)
    ros.run(timeout=10)
    got = threading.Event()

    def show(message: object) -> None:
        print(json.dumps(message), flush=True)
        got.set()

    reader = roslibpy.Topic(ros, "/to_client", "sensor_msgs/Imu")
    reader.subscribe(show)
    writer = roslibpy.Topic(ros, "/from_client", "std_msgs/String")
    writer.advertise()
    print("ready", flush=True)
    for line in sys.stdin:
        word = line.strip()
        if word == "end":
            break
        writer.publish(roslibpy.Message({"data": word}))
    reader.unsubscribe()
    writer.unadvertise()
    ros.terminate()


if __name__ == "__main__":
    main()
