"""A megabyte of each kind of operation that a client of the WebSocket listener may send."""

from __future__ import annotations

import itertools
import json
import struct
from collections.abc import Callable, Iterator
from typing import Any, Final

import cbor2

from ropeway.networks.rosbridge.protocol.records import RecordWriter
from tests.support.websocket import BINARY, CONTINUATION, TEXT, frame

__all__ = ["GATEWAY", "PLAIN", "SENT_BYTES", "Make", "a_megabyte", "operation"]

SENT_BYTES: Final = 1 << 20
Make = Callable[[int], bytes]
"""Makes one thing after another of a kind, by its number."""

_HEADS: Final = 64  # of frames and the like
_PUBLISHERS: Final = 1000  # of the kind whose every frame makes one; a client may have 4,096
_STRING: Final = "std_msgs/String"
_FIBONACCI: Final = "example_interfaces/action/Fibonacci"
_TEXT: Final = "x" * 1000


def operation(op: str, **fields: Any) -> bytes:
    return frame(TEXT, json.dumps({"op": op, **fields}).encode())


def a_megabyte(make: Make, size: int = SENT_BYTES) -> Iterator[bytes]:
    """Things of one kind, of ``size`` bytes in all at most."""
    made = 0
    for number in itertools.count():
        data = make(number)
        made += len(data)
        if made > size + _HEADS or (make is PLAIN["advertise_deep"] and number >= _PUBLISHERS):
            return
        yield data


def _padded(text: str) -> bytes:
    """A frame of nearly a megabyte, so much of which is this text again and again."""
    return frame(TEXT, b'{"op": "publish", "topic": "/t", "msg": ' + text.encode() + b"}")


def _records(*pieces: bytes) -> bytes:
    return frame(BINARY, b"".join(pieces))


def _first(channel: int, total: int) -> bytes:
    out: list[bytes] = []
    RecordWriter().first(out, channel, 3, total, b"x", b"o" * 16, 1, 1)
    return b"".join(out)


def _told(number: int, text: str) -> bytes:
    about = {"topic": f"/t{number}", "type": f"my_msgs/msg/T{number}"}
    return operation("advertise", **about, ropeway={"channel": number, "definition": text})


def _rosapi(service: str, **args: Any) -> Make:
    return lambda n: operation("call_service", service=f"/rosapi/{service}", id=f"{n}", args=args)


PLAIN: Final[dict[str, Make]] = {
    "advertise": lambda n: operation("advertise", topic=f"/t{n}", type=_STRING, latch=True),
    "advertise_deep": lambda n: operation(
        "advertise", topic=f"/t{n}", type=_STRING, qos={"durability": "transient_local", "depth": 2**31 - 1}
    )
    + operation("publish", topic=f"/t{n}", msg={"data": "x"}),
    "publish": lambda n: operation("publish", topic="/t", type=_STRING, msg={"data": _TEXT}),
    "publish_unknown": lambda n: operation("publish", topic=f"/t{n}", msg={"data": _TEXT}),
    "subscribe": lambda n: operation("subscribe", topic=f"/t{n % 50}", type=_STRING, id=f"{n}"),
    "subscribe_many": lambda n: operation("subscribe", topic=f"/t{n}", type=_STRING),
    "subscribe_throttled": lambda n: operation(
        "subscribe", topic="/t", type=_STRING, throttle_rate=600_000, queue_length=10**9
    )
    + operation("publish", topic="/t", type=_STRING, msg={"data": _TEXT}),
    "subscribe_unborn": lambda n: operation("subscribe", topic=f"/unborn{n}", id=_TEXT[:900]),
    "unsubscribe": lambda n: operation("unsubscribe", topic=f"/t{n}"),
    "call_service": lambda n: operation("call_service", service=f"/s{n}", id=f"{n}", args={"data": _TEXT}),
    "call_nothing": lambda n: operation("call_service", service="/s"),
    "call_typed": lambda n: operation("call_service", service=f"/s{n}", type="std_srvs/Trigger", id=f"{n}"),
    "publish_behind": lambda n: frame(TEXT, b'{"op":"publish","topic":"/t","msg":[' + b"{}," * 1000 + b"0]}")
    if n
    else operation("advertise", topic="/t", type=_STRING),
    "advertise_service": lambda n: operation("advertise_service", service=f"/s{n}", type="std_srvs/Trigger"),
    "call_own_service": lambda n: operation("call_service", service="/own", id=f"{n}")
    if n
    else operation("advertise_service", service="/own", type="std_srvs/Trigger"),
    "advertise_action": lambda n: operation("advertise_action", action=f"/a{n}", type=_FIBONACCI),
    "send_action_goal": lambda n: operation(
        "send_action_goal", action=f"/a{n}", action_type=_FIBONACCI, args={"order": 3}, feedback=True, id=f"{n}"
    ),
    "send_own_goal": lambda n: operation(
        "send_action_goal", action="/own", action_type=_FIBONACCI, args={"order": 3}, feedback=True, id=f"{n}"
    )
    if n
    else operation("advertise_action", action="/own", type=_FIBONACCI),
    "cancel_action_goal": lambda n: operation("cancel_action_goal", action="/a", id=f"{n}"),
    "rosapi_topics": _rosapi("topics"),
    "rosapi_nodes": _rosapi("nodes"),
    "rosapi_interfaces": _rosapi("interfaces"),
    "rosapi_raw_types": _rosapi("topics_and_raw_types"),
    "rosapi_details": _rosapi("message_details", type="sensor_msgs/PointCloud2"),
    "rosapi_param_names": _rosapi("get_param_names"),
    "rosapi_get_param": _rosapi("get_param", name="/memory:use_sim_time", default_value="[" * 10),
    "rosapi_set_param": _rosapi("set_param", name="/memory:x", value=_TEXT),
    "service_response": lambda n: operation("service_response", service="/s", id=f"{n}", values={}, result=True),
    "fragment": lambda n: operation("fragment", id=f"{n % 100}", data="", num=n // 100, total=60_000),
    "long_names": lambda n: operation("subscribe", topic="/" + "a" * 10_000, type=_STRING, id=f"{n}"),
    "long_ids": lambda n: operation("subscribe", topic="/t", type=_STRING, id="a" * 10_000 + f"{n}"),
    "unknown_types": lambda n: operation("advertise", topic=f"/t{n}", type=f"sensor_msgs/Imag{n}"),
    "unfinished_json": lambda n: frame(TEXT, b'{"op": "publish", "msg": {"data": "' + b"x" * 1000),
    "no_json": lambda n: frame(TEXT, b"[{" * 500),
    "json_lists": lambda n: frame(TEXT, b'{"op": "publish", "msg": [' + b"[]," * 30_000 + b"1]}"),
    "json_numbers": lambda n: _padded("[0" + ",0" * 500_000 + "]"),
    "json_long_numbers": lambda n: _padded("[12345" + ",12345" * 170_000 + "]"),
    "json_objects": lambda n: _padded("[{}" + ",{}" * 340_000 + "]"),
    "json_brackets": lambda n: _padded("[" * 100 + "],[" * 300_000 + "]" * 100),
    "json_keys": lambda n: _padded("{" + ",".join(f'"{i:x}":0' for i in range(110_000)) + "}"),
    "json_texts": lambda n: _padded('["a"' + ',"b"' * 250_000 + "]"),
    "json_deep": lambda n: frame(TEXT, b"[" * 1_000_000),
    "json_named": lambda n: frame(TEXT, b'{"op": "call_service", "id": "1", "args": [' + b"NaN," * 250_000 + b"0]}"),
    "cbor_lists": lambda n: frame(BINARY, b"\xa1\x63msg\x9a" + (100_000).to_bytes(4, "big") + b"\x80" * 100_000),
    "cbor_numbers": lambda n: frame(BINARY, b"\xa1\x63msg\x9a" + (10**6).to_bytes(4, "big") + b"\x00" * 10**6),
    "cbor_pairs": lambda n: frame(BINARY, b"\xa1\x63msg\x9a" + (500_000).to_bytes(4, "big") + b"\x81\x00" * 500_000),
    "cbor_maps": lambda n: frame(BINARY, b"\xa1\x63msg\x9a" + (300_000).to_bytes(4, "big") + b"\xa1\x00\x00" * 300_000),
    "cbor": lambda n: frame(BINARY, cbor2.dumps({"op": "publish", "topic": "/t", "type": _STRING, "msg": {}})),
    "pieces": lambda n: frame(TEXT if n == 0 else CONTINUATION, b"x" * 1000, fin=False),
}  # fmt: skip
GATEWAY: Final[dict[str, Make]] = {
    "first_records": lambda n: _records(_first(n % 60_000 + 1, 64 << 20)),
    "origins": lambda n: _records(struct.pack("<BBHHHIQq", 4, 0, 0, n % 4096, 0, 16, 0, 0), struct.pack("<QQ", n, n)),
    "definition_of_texts": lambda n: _told(n % 60_000 + 1, "string[16777215] a\n"),
    "definition_of_fields": lambda n: _told(n % 60_000 + 1, "".join(f"bool a{i}\n" for i in range(20_000))),
    "definition_of_arrays": lambda n: _told(n % 60_000 + 1, "bool[8388600] a\n"),
    "definitions": lambda n: _told(n % 60_000 + 1, "bool a\n"),
    "watch": lambda n: operation("watch") if n == 0 else operation("ping", t=n),
}
