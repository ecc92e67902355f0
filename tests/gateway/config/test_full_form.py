"""The full form of every kind of configuration is a configuration: edits, rollbacks and workers read it again."""

from __future__ import annotations

import json
from typing import Any, Final

import pytest

from ropeway.gateway.config.config import parse

STRING: Final = "std_msgs/msg/String"
TWIST: Final = "geometry_msgs/msg/Twist"
TOPIC: Final = {"name": "/n", "type": STRING}
WS: Final = "ws://127.0.0.1:5"
OVERLAY: Final = {"identity": "/dev/null", "routers": ["tls/127.0.0.1:7"], "listen": []}
MAP: Final = {"system": "*", "topic": "cmd", "type": TWIST, "form": "floats"}
EVERYTHING: Final[dict[str, tuple[dict[str, Any], list[dict[str, Any]]]]] = {
    "overlay": ({"overlay": OVERLAY}, [{"address": "overlay", "publish": [TOPIC]}]),
    "overlay, automatic": ({"overlay": OVERLAY}, [{"address": "overlay", "automatic": {"allow": ["/a"]}}]),
    "overlay, group": ({"overlay": OVERLAY}, [{"address": "overlay", "anycast": {}, "publish": [TOPIC]}]),
    "nodes": ({}, [{"address": "iort://127.0.0.1:5", "publish": [TOPIC]}]),
    "ROS 1": ({}, [{"address": WS, "ros": 1, "publish": [TOPIC]}]),
    "several links": ({}, [{"address": WS, "interfaces": ["lo", "eth0"], "links": "duplicate", "publish": [TOPIC]}]),
    "group": ({}, [{"address": [WS, "ws://127.0.0.1:6"], "anycast": {}, "publish": [TOPIC]}]),
    "secrets": ({}, [{"address": "wss://127.0.0.1:5", "tls": {"ca": "/dev/null"}, "token": {"env": "X"}}]),
    "paused": ({}, [{"address": WS, "active": False, "publish": [{**TOPIC, "active": False}]}]),
    "graphs": ({"graphs": ["dds:0", {"address": "dds:1", "distro": "humble"}, "zenoh", "ros1", "ros2:3"]}, []),
    "listeners": ({"listen": [WS, "iort://127.0.0.1:6", "foxglove://127.0.0.1:7"], "rest": True}, []),
    "maps": ({"listen": ["iort://127.0.0.1:6"], "iort": {"maps": [MAP]}}, []),
    "roles": (
        {
            "auth": {
                "tokens": [{"token": {"env": "X"}, "role": "r"}],
                "roles": {"r": {"control": ["observe"], "publish": ["*"]}},
            },
            "control": {"listen": ["http://127.0.0.1:9"]},
        },
        [],
    ),
    "nothing": ({"control": False, "audit": False}, []),
    "audit": (
        {"audit": {"commands": [{"names": ["/a"]}]}, "workers": 2},
        [
            {
                "address": WS,
                "publish": [{**TOPIC, "audit": True, "expected": {"bytes": 1, "hz": 1}}],
                "link": {"mbit": 1},
            }
        ],
    ),
    "safety": (
        {"safety": [{"topic": "/cmd", "type": TWIST, "lease_s": 1}]},
        [{"address": WS, "subscribe": [{"name": "/c", "type": TWIST, "safety": {"lease_s": 1, "on_expiry": "zero"}}]}],
    ),
    "store": ({"store": {"path": "/tmp/x"}}, [{"address": WS, "publish": [{**TOPIC, "store": True}]}]),
    "web servers": (
        {
            "http": [
                {
                    "url": "http://a/",
                    "topic": "/a",
                    "type": STRING,
                    "files": [{}],
                    "headers": {"x-a": "b"},
                    "fields": [{"value": 1, "to": "x"}, {"from": "a", "to": "b"}],
                    "answer": {"topic": "/b", "type": STRING, "fields": [{"of": "message", "from": "", "to": "data"}]},
                }
            ]
        },
        [],
    ),
}


@pytest.mark.parametrize("kind", EVERYTHING)
def test_reads_its_own_full_form(kind: str) -> None:
    """What is written out in full is read again as the same, whatever kinds of remotes and keys there are."""
    gateway, remotes = EVERYTHING[kind]
    whole = {"name": "a", "graphs": ["memory:x"], "listen": [], "insecure": True, **gateway}
    config = parse({"gateway": whole, "remotes": remotes})
    again = parse(json.loads(json.dumps(config.to_json())))
    assert again == config
    assert again.etag == config.etag
