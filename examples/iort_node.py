"""Be a robot that knows no ROS: python examples/iort_node.py [iort://127.0.0.1:7410].

`ropeway/iort.py` is one file for Python 3.8 without dependencies: copy it to a robot that has no more.
A gateway with `"listen": ["iort://127.0.0.1:7410"]` serves it; while there is none, values are kept for later.
"""

import sys

from ropeway.iort import Node

url = sys.argv[1] if len(sys.argv) > 1 else "iort://127.0.0.1:7410"
with Node("PEPPER", url) as node:
    node.publish("battery", "80")
    node.subscribe("cmd_vel", lambda value: print("drive", value.floats))
    print("battery:", node.read("battery").text, "mode:", node.mode)
