"""What the server's clock fills in."""

from __future__ import annotations

from typing import Any

from ropeway.types import TypeRegistry
from ropeway.types.now import replace_now, stamp_header

REGISTRY = TypeRegistry()
NOW = 1_700_000_000_123_456_789
TIME = {"sec": 1_700_000_000, "nanosec": 123_456_789}


def test_header_without_stamp() -> None:
    """A header gets a stamp where it has none, and keeps the one it has."""
    codec = REGISTRY.codec("geometry_msgs/TwistStamped")
    values: list[dict[str, Any]] = [{}, {"header": {}}, {"header": {"frame_id": "f"}}]
    for value in values:
        cdr = codec.from_json(value, now_ns=lambda: NOW)
        assert codec.header_stamp_ns(cdr) == NOW
        assert codec.decode(cdr)["header"]["frame_id"] == value.get("header", {}).get("frame_id", "")
    for stamp in ({"sec": 0, "nanosec": 0}, {}, {"secs": 0}):
        assert codec.header_stamp_ns(codec.from_json({"header": {"stamp": stamp}}, now_ns=lambda: NOW)) == 0
    assert codec.header_stamp_ns(codec.from_cbor({}, now_ns=lambda: NOW)) == NOW
    assert codec.header_stamp_ns(codec.encode({})) == 0
    assert codec.header_stamp_ns(codec.encode({})) == 0


def test_only_the_root_header() -> None:
    """A header further down keeps the zero of its stamp, and so does a message that is itself a header."""
    codec = REGISTRY.codec("tf2_msgs/TFMessage")
    assert codec.decode(codec.from_json({"transforms": [{}]}, now_ns=lambda: NOW))["transforms"][0]["header"][
        "stamp"
    ] == {
        "sec": 0,
        "nanosec": 0,
    }
    codec = REGISTRY.codec("std_msgs/Header")
    assert codec.decode(codec.from_json({}, now_ns=lambda: NOW))["stamp"]["sec"] == 0


def test_now() -> None:
    """The Time "now" is the server's time, wherever it stands."""
    codec = REGISTRY.codec("tf2_msgs/TFMessage")
    value = {"transforms": [{}, {"header": {"stamp": "now"}}]}
    decoded = codec.decode(codec.from_json(value, now_ns=lambda: NOW))
    assert [t["header"]["stamp"] for t in decoded["transforms"]] == [{"sec": 0, "nanosec": 0}, TIME]
    codec = REGISTRY.codec("builtin_interfaces/Time")
    assert codec.decode(codec.from_json("now", now_ns=lambda: NOW)) == TIME


def test_values_that_are_no_messages() -> None:
    """What does not look like the message is left for others to complain of."""
    assert stamp_header([], lambda: NOW) == []
    assert stamp_header({"header": 5}, lambda: NOW) == {"header": 5}
    value: dict[str, Any] = {"poses": {"x": 1}, "header": "now"}
    assert replace_now("nav_msgs/msg/Path", value, REGISTRY.definition, NOW) is value
    value = {"poses": [1, None, {"header": {"stamp": 7}}]}
    assert replace_now("nav_msgs/msg/Path", value, REGISTRY.definition, NOW) is value
