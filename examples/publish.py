"""Publish a topic ten times a second: python examples/publish.py [dds:0]."""

import itertools
import sys
import time

from ropeway import blocking

url = sys.argv[1] if len(sys.argv) > 1 else "dds:0"
with blocking.open(url, name="talker") as graph, graph.publisher("/chatter", "std_msgs/String") as publisher:
    for number in itertools.count():
        publisher.publish({"data": f"hello {number}"})
        time.sleep(0.1)
