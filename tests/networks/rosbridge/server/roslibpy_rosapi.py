"""A client of roslibpy that asks rosapi, run as a program of its own by the tests.

``python roslibpy_rosapi.py TRANSPORT PORT PLAN``: the plan is a list of [method of Ros, ...arguments], all of which
wait for their answers. One JSON line is written per answer: {"ask": number, "answer": value} or {…, "failed": text}.
"""

from __future__ import annotations

import json
import sys
from typing import Any

import roslibpy


def main() -> None:
    """Ask one after the other."""
    transport, port, text = sys.argv[1:]
    ros = roslibpy.Ros("127.0.0.1", int(port), transport=transport)
    ros.run()
    print(json.dumps({"client": 0, "connected": True}), flush=True)
    for number, (method, *args) in enumerate(json.loads(text)):
        said: dict[str, Any] = {"ask": number}
        try:
            said["answer"] = getattr(ros, method)(*args)
        except Exception as error:  # whatever the library raises is its answer
            said["failed"] = str(error)
        print(json.dumps(said, default=dict), flush=True)
    sys.stdin.read()
    ros.close()
    ros.terminate()


if __name__ == "__main__":
    main()
