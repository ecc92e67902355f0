from __future__ import annotations

import json
import math
from typing import Any, get_args

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import InvalidOperation
from ropeway.networks.rosbridge.protocol import ops

JSON = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: st.lists(inner, max_size=3) | st.dictionaries(st.text(max_size=8), inner, max_size=3),
    max_leaves=6,
)
FIELDS = sorted({key for cls in get_args(ops.Op) for key in (*cls.KEYS, "ropeway")})

# what a peer sends, and what is understood
GOOD: list[tuple[dict[str, Any], ops.Op]] = [
    (
        {"op": "advertise", "id": "advertise:/t:1", "type": "a/B", "topic": "/t", "latch": True, "queue_size": 0},
        ops.Advertise(topic="/t", type="a/B", id="advertise:/t:1", latch=True, queue_size=0),
    ),
    (
        {"op": "advertise", "topic": "/t", "type": "a/B", "latch": None, "queue_size": None, "qos": None, "id": None},
        ops.Advertise(topic="/t", type="a/B"),
    ),
    (
        {"op": "advertise", "topic": "/t", "type": "a/B", "queue_size": "x", "compression": "rawzip"},
        ops.Advertise(topic="/t", type="a/B", compression="rawzip"),
    ),
    ({"op": "unadvertise", "topic": "/t"}, ops.Unadvertise(topic="/t")),
    ({"op": "publish", "topic": "/t"}, ops.Publish(topic="/t", msg={})),
    (
        {"op": "publish", "topic": "/t", "msg": {"data": 1}, "latch": False, "id": 7, "type": "a/B"},
        ops.Publish(topic="/t", msg={"data": 1}, latch=False, id=7, type="a/B"),
    ),
    (
        {"op": "publish", "topic": "/t", "msg": b"\x04", "compression": "zip"},
        ops.Publish(topic="/t", msg=b"\x04", compression="zip"),
    ),
    (
        {"op": "subscribe", "topic": "/t", "throttle_rate": None, "queue_length": None, "fragment_size": None},
        ops.Subscribe(topic="/t"),
    ),
    (
        {"op": "subscribe", "topic": "/t", "throttle_rate": 100.5, "queue_length": 1.0, "fragment_size": 2147483647},
        ops.Subscribe(topic="/t", throttle_rate=100.5, queue_length=1, fragment_size=2147483647),
    ),
    (
        {"op": "subscribe", "topic": "/t", "throttle_rate": -1, "queue_length": -1, "fragment_size": -1},
        ops.Subscribe(topic="/t"),
    ),
    (
        {"op": "subscribe", "topic": "/t", "throttle_rate": math.nan, "queue_length": math.inf},
        ops.Subscribe(topic="/t"),
    ),
    (
        {"op": "subscribe", "topic": "/t", "compression": "brotli", "qos": {"depth": 1}, "ropeway": {"channel": 3}},
        ops.Subscribe(topic="/t", compression="brotli", qos={"depth": 1}, ropeway={"channel": 3}),
    ),
    ({"op": "unsubscribe", "topic": "/t", "id": [1, {"a": None}]}, ops.Unsubscribe(topic="/t", id=[1, {"a": None}])),
    ({"op": "call_service", "service": "/s"}, ops.CallService(service="/s", args=None)),
    (
        {"op": "call_service", "service": "/s#x", "args": [1], "timeout": 2, "fragment_size": None, "type": 5},
        ops.CallService(service="/s#x", args=[1], id="x", timeout=2),
    ),
    (
        {"op": "call_service", "service": "/s#x", "id": "y", "args": {}},
        ops.CallService(service="/s#x", args={}, id="y"),
    ),
    (
        {"op": "service_response", "service": "/s", "result": False, "id": "1"},
        ops.ServiceResponse(service="/s", values=None, result=False, id="1"),
    ),
    (
        {"op": "advertise_service", "service": "/s", "type": "a/B", "id": None},
        ops.AdvertiseService(service="/s", type="a/B"),
    ),
    ({"op": "unadvertise_service", "service": "/s"}, ops.UnadvertiseService(service="/s")),
    (
        {"op": "send_action_goal", "action": "/a", "action_type": "a/B", "feedback": 1, "id": "g"},
        ops.SendActionGoal(action="/a", action_type="a/B", args=None, feedback=True, id="g"),
    ),
    (
        {"op": "send_action_goal", "action": "/a#g", "type": "a/B", "args": {}},
        ops.SendActionGoal(action="/a#g", action_type="a/B", args={}, id="g"),
    ),
    ({"op": "cancel_action_goal", "action": "/a#g"}, ops.CancelActionGoal(action="/a#g", id="g")),
    (
        {"op": "action_feedback", "action": "/a", "id": "g", "values": {"n": 1}},
        ops.ActionFeedback(action="/a", id="g", values={"n": 1}),
    ),
    (
        {"op": "action_result", "action": "/a", "id": "g", "values": {}, "result": True},
        ops.ActionResult(action="/a", id="g", values={}, result=True, status=4),
    ),
    (
        {"op": "action_result", "action": "/a", "id": "g", "result": False},
        ops.ActionResult(action="/a", id="g", values=None, result=False, status=6),
    ),
    (
        {"op": "action_result", "action": "/a", "id": "g", "values": {}, "result": True, "status": 5},
        ops.ActionResult(action="/a", id="g", values={}, result=True, status=5),
    ),
    ({"op": "advertise_action", "action": "/a", "type": "a/B"}, ops.AdvertiseAction(action="/a", type="a/B")),
    ({"op": "unadvertise_action", "action": "/a"}, ops.UnadvertiseAction(action="/a")),
    (
        {"op": "fragment", "id": 0, "data": "x", "num": 5, "total": 5.6},
        ops.Fragment(id=0, data="x", num=5, total=6),
    ),
    ({"op": "png", "data": "aa"}, ops.Png(data="aa")),
    ({"op": "status", "level": "error", "msg": "no", "id": "1"}, ops.Status(level="error", msg="no", id="1")),
]

# what is refused, and with which text
BAD: list[tuple[dict[Any, Any], str]] = [
    ({}, "Received a message without an op.  All messages require 'op' field with value one of: ['advertise', "),
    ({1: 2}, "Received a message without an op."),
    ({"op": "set_level"}, "Unknown operation: set_level.  Allowed operations: ['advertise', 'unadvertise', "),
    ({"op": "auth", "mac": "x"}, "Unknown operation: auth.  Allowed operations: ["),
    ({"op": ["x"]}, "Unknown operation: <list>.  Allowed operations: ["),
    ({"op": None}, "Unknown operation: None."),
    ({"op": "x" * 1_000_000}, "Unknown operation: xxx"),
    ({"op": "advertise", "topic": "/t"}, "advertise: Expected a type field but none was found."),
    ({"op": "advertise", "type": "a/B"}, "advertise: Expected a topic field but none was found."),
    (
        {"op": "advertise", "topic": 5, "type": "a/B"},
        "advertise: Expected field topic to be one of (<class 'str'>,). Invalid value: 5",
    ),
    (
        {"op": "advertise", "topic": "/t", "type": "a/B", "qos": 1},
        "advertise: Expected field qos to be one of (<class 'dict'>,). Invalid value: 1",
    ),
    ({"op": "advertise", "topic": "/t", "type": "a/B", "compression": []}, "advertise: Expected field compression"),
    ({"op": "advertise", "topic": "/t", "type": "a/B", "ropeway": 0}, "advertise: Expected field ropeway to be one of"),
    ({"op": "unadvertise"}, "unadvertise: Expected a topic field but none was found."),
    ({"op": "publish", "msg": {}}, "publish: Expected a topic field but none was found."),
    (
        {"op": "publish", "topic": "/t", "msg": "hello"},
        "publish: Expected field msg to be one of (<class 'dict'>,). Invalid value: hello",
    ),
    ({"op": "publish", "topic": "/t", "msg": None}, "publish: Expected field msg to be one of"),
    ({"op": "publish", "topic": "/t", "msg": [b"x" * 10_000_000]}, "publish: Expected field msg to be one of"),
    (
        {"op": "subscribe", "topic": "/t", "throttle_rate": "100"},
        "subscribe: Expected field throttle_rate to be one of (<class 'int'>,). Invalid value: 100",
    ),
    ({"op": "subscribe", "topic": "/t", "queue_length": {}}, "subscribe: Expected field queue_length to be one of"),
    ({"op": "subscribe", "topic": None}, "subscribe: Expected field topic to be one of (<class 'str'>,). Invalid"),
    ({"op": "unsubscribe", "topic": []}, "unsubscribe: Expected field topic to be one of"),
    ({"op": "call_service", "id": "1"}, "call_service: Expected a service field but none was found."),
    ({"op": "call_service", "service": "/s", "timeout": "1"}, "call_service: Expected field timeout to be one of"),
    ({"op": "service_response", "service": "/s", "id": "1"}, "service_response: Expected a result field but none was"),
    (
        {"op": "service_response", "service": "/s", "result": 1},
        "service_response: Expected field result to be one of (<class 'bool'>,). Invalid value: 1",
    ),
    ({"op": "advertise_service", "service": "/s"}, "advertise_service: Expected a type field but none was found."),
    ({"op": "unadvertise_service"}, "unadvertise_service: Expected a service field but none was found."),
    ({"op": "send_action_goal", "action": "/a"}, "send_action_goal: Expected a action_type field but none was found."),
    ({"op": "cancel_action_goal"}, "cancel_action_goal: Expected a action field but none was found."),
    ({"op": "action_feedback", "values": {}}, "action_feedback: Expected a action field but none was found."),
    ({"op": "action_result", "action": "/a"}, "action_result: Expected a result field but none was found."),
    ({"op": "action_result", "action": "/a", "result": True, "status": "4"}, "action_result: Expected field status"),
    ({"op": "advertise_action", "type": "a/B"}, "advertise_action: Expected a action field but none was found."),
    ({"op": "unadvertise_action"}, "unadvertise_action: Expected a action field but none was found."),
    ({"op": "fragment", "data": "", "num": 0, "total": 1}, "received invalid fragment! No message ID found."),
    ({"op": "fragment", "id": "1", "num": 0, "total": 1}, "fragment: received invalid fragment!"),
    ({"op": "fragment", "id": "1", "data": b"", "num": 0, "total": 1}, "fragment: received invalid fragment!"),
    ({"op": "fragment", "id": "1", "data": "", "num": 0.5, "total": 1}, "fragment: received invalid fragment!"),
    ({"op": "fragment", "id": "1", "data": "", "num": 1, "total": 1}, "fragment: received invalid fragment!"),
    ({"op": "fragment", "id": "1", "data": "", "num": -1, "total": 1}, "fragment: received invalid fragment!"),
    ({"op": "fragment", "id": "1", "data": "", "num": 0, "total": math.nan}, "fragment: received invalid fragment!"),
    ({"op": "fragment", "id": "1", "data": "", "num": 0, "total": math.inf}, "fragment: received invalid fragment!"),
    ({"op": "fragment", "id": "1", "data": "", "num": 0, "total": 0}, "fragment: received invalid fragment!"),
    ({"op": "png"}, "png: Expected a data field but none was found."),
    ({"op": "publish", "topic": "/t", "id": b"bytes"}, "publish: Expected field id to be one of"),
    ({"op": "publish", "topic": "/t", "id": [object()]}, "publish: Expected field id to be one of"),
]

# what is sent, to the letter
SENT: list[tuple[ops.Op, str]] = [
    (
        ops.Advertise(id="a:1", topic="/t", type="a/B", compression="cbor"),
        '{"op":"advertise","id":"a:1","topic":"/t","type":"a/B","compression":"cbor"}',
    ),
    (
        ops.Advertise(topic="/t", type="a/B", latch=True, queue_size=0, qos={"depth": 1}),
        '{"op":"advertise","topic":"/t","type":"a/B","latch":true,"queue_size":0,"qos":{"depth":1}}',
    ),
    (ops.Unadvertise(id="u:1", topic="/t"), '{"op":"unadvertise","id":"u:1","topic":"/t"}'),
    (ops.Publish(topic="/t", msg={"data": "x"}), '{"op":"publish","topic":"/t","msg":{"data":"x"}}'),
    (
        ops.Subscribe(id="s:1", topic="/t", type="a/B", compression="cbor-raw"),
        '{"op":"subscribe","id":"s:1","topic":"/t","type":"a/B","compression":"cbor-raw"}',
    ),
    (
        ops.Subscribe(topic="/t", throttle_rate=50, queue_length=1, fragment_size=100, ropeway={"channel": 1}),
        '{"op":"subscribe","topic":"/t","throttle_rate":50,"queue_length":1,"fragment_size":100,'
        '"ropeway":{"channel":1}}',
    ),
    (ops.Unsubscribe(id="s:1", topic="/t"), '{"op":"unsubscribe","id":"s:1","topic":"/t"}'),
    (
        ops.CallService(id="service_request:/s:1", service="/s", args={"a": 1}),
        '{"op":"call_service","id":"service_request:/s:1","service":"/s","args":{"a":1}}',
    ),
    (
        ops.CallService(id="svc:0", service="/s", type="a/B", args={}, compression="cbor"),
        '{"op":"call_service","id":"svc:0","service":"/s","type":"a/B","args":{},"compression":"cbor"}',
    ),
    (
        ops.ServiceResponse(service="/s#1", values={"ok": True}, result=True, id=0),
        '{"op":"service_response","service":"/s#1","values":{"ok":true},"result":true,"id":0}',
    ),
    (
        ops.ServiceResponse(service="/s", values="Service /s does not exist", result=False),
        '{"op":"service_response","service":"/s","values":"Service /s does not exist","result":false}',
    ),
    (
        ops.ServiceResponse(service="/s", values={}, result=True, id="1", compression="cbor"),
        '{"op":"service_response","service":"/s","result":true,"id":"1","values":{},"compression":"cbor"}',
    ),
    (
        ops.AdvertiseService(id="e:1", service="/s", type="a/B"),
        '{"op":"advertise_service","id":"e:1","service":"/s","type":"a/B"}',
    ),
    (
        ops.UnadvertiseService(id="d:1", service="/s"),
        '{"op":"unadvertise_service","id":"d:1","service":"/s"}',
    ),
    (
        ops.SendActionGoal(id="action_goal:/a:1", action="/a", action_type="a/B", args={}, feedback=True),
        '{"op":"send_action_goal","id":"action_goal:/a:1","action":"/a","action_type":"a/B","args":{},"feedback":true}',
    ),
    (
        ops.SendActionGoal(id="act:0", action="/a", action_type="a/B", args={}, compression="zip"),
        '{"op":"send_action_goal","id":"act:0","action":"/a","action_type":"a/B","args":{},"compression":"zip"}',
    ),
    (ops.CancelActionGoal(id="g", action="/a"), '{"op":"cancel_action_goal","id":"g","action":"/a"}'),
    (
        ops.ActionFeedback(action="/a", values={}, id="g"),
        '{"op":"action_feedback","action":"/a","values":{},"id":"g"}',
    ),
    (
        ops.ActionFeedback(goal_id="u", action="/a", values={}, result=True, id="g", compression="cbor"),
        '{"op":"action_feedback","goal_id":"u","action":"/a","result":true,"id":"g","values":{},"compression":"cbor"}',
    ),
    (
        ops.ActionResult(action="/a", values={}, status=4, result=True, id="g"),
        '{"op":"action_result","action":"/a","values":{},"status":4,"result":true,"id":"g"}',
    ),
    (
        ops.ActionResult(goal_id="u", action="/a", values={}, status=4, result=True, id="g", compression="cbor"),
        '{"op":"action_result","goal_id":"u","action":"/a","result":true,"id":"g","values":{},"compression":"cbor"}',
    ),
    (
        ops.AdvertiseAction(id="e", action="/a", type="a/B"),
        '{"op":"advertise_action","id":"e","action":"/a","type":"a/B"}',
    ),
    (ops.UnadvertiseAction(id="d", action="/a"), '{"op":"unadvertise_action","id":"d","action":"/a"}'),
    (
        ops.Fragment(id="1", data="{", num=0, total=2),
        '{"op":"fragment","id":"1","data":"{","num":0,"total":2}',
    ),
    (ops.Png(data="aa"), '{"op":"png","data":"aa"}'),
    (ops.Status(level="error", msg="no", id=1), '{"op":"status","id":1,"level":"error","msg":"no"}'),
]


@pytest.mark.parametrize(("message", "op"), GOOD, ids=str)
def test_what_clients_send_is_understood(message: dict[str, Any], op: ops.Op) -> None:
    """Every operation is read with its defaults, and with what known clients send besides."""
    assert ops.parse(message) == op


@pytest.mark.parametrize(("message", "text"), BAD, ids=range(len(BAD)))
def test_bad_operations_are_refused_with_rosbridges_texts(message: dict[str, Any], text: str) -> None:
    """A missing, ill-typed or unknown thing raises InvalidOperation with a short text and the id."""
    with pytest.raises(InvalidOperation) as caught:
        ops.parse(message)
    assert text in str(caught.value)
    assert len(str(caught.value)) < 700
    if isinstance(message.get("id"), str):
        assert caught.value.id == message["id"]


@pytest.mark.parametrize(("op", "text"), SENT, ids=lambda value: value if isinstance(value, str) else "")
def test_operations_are_written_in_the_order_of_their_protocol(op: ops.Op, text: str) -> None:
    """to_dict gives the keys in rosbridge's order, in rosgw's where compression is named, without defaults."""
    assert ops.dumps(op.to_dict()).decode() == text
    if not getattr(op, "goal_id", None):
        assert ops.parse(json.loads(text)) == op


def test_an_id_is_absent_or_echoed_verbatim() -> None:
    """Every JSON value but null is an id; null is none, and does not hide the one behind an old client's name."""
    assert not ops.present(ops.parse({"op": "unsubscribe", "topic": "/t"}).id)
    assert not ops.present(ops.parse({"op": "unsubscribe", "topic": "/t", "id": None}).id)
    assert ops.parse({"op": "call_service", "service": "/s#7", "id": None}).id == "7"
    for id in ("", 0, 1.5, "é", 2**80, [1, "a"], {"a": {"b": None}}):
        op = ops.parse({"op": "unsubscribe", "topic": "/t", "id": id})
        assert ops.present(op.id)
        assert json.loads(ops.dumps(op.to_dict()))["id"] == id


def test_json_is_ascii() -> None:
    """Texts beyond ASCII are written as escapes, above the basic plane as pairs."""
    assert ops.dumps({"a": "é \N{PILE OF POO} \x7f"}) == b'{"a":"\\u00e9 \\ud83d\\udca9 \x7f"}'


def test_the_name_has_no_suffix() -> None:
    """The old-style id behind a name is not a part of the name that is called."""
    assert ops.CallService(service="/s#1", args=None).name == "/s"
    assert ops.SendActionGoal(action="/a#1#2", action_type="", args=None).name == "/a"
    assert ops.CancelActionGoal(action="/a").name == "/a"


@given(
    st.dictionaries(st.sampled_from(FIELDS), JSON),
    st.sampled_from((*ops.ALLOWED, "png", "status", "nothing")) | JSON,
)
def test_whatever_comes_only_invalid_operation_is_raised(fields: dict[str, Any], op: Any) -> None:
    """Reading gives an operation that can be written again, or raises InvalidOperation."""
    try:
        parsed = ops.parse({**fields, "op": op})
    except InvalidOperation:
        return
    assert parsed.op == op
    ops.dumps(parsed.to_dict())


@pytest.mark.parametrize(
    ("op", "key"),
    [
        ("subscribe", "topic"), ("unsubscribe", "topic"), ("advertise", "topic"), ("publish", "topic"),
        ("call_service", "service"), ("service_response", "service"), ("advertise_service", "service"),
        ("send_action_goal", "action"), ("cancel_action_goal", "action"), ("action_result", "action"),
        ("advertise", "type"), ("subscribe", "type"), ("advertise_service", "type"),
        ("send_action_goal", "action_type"),
        ("subscribe", "compression"),
    ],
)  # fmt: skip
def test_long_names(op: str, key: str) -> None:
    """A name that is longer than any is refused, and the text of the error stays short."""
    fields = {"topic": "/t", "type": "a/B", "service": "/s", "action": "/a", "action_type": "a/B", "result": True}
    with pytest.raises(InvalidOperation) as failed:
        ops.parse({"op": op, **fields, "values": {}, key: "x" * 1_000_000})
    assert len(str(failed.value)) < 1000


@pytest.mark.parametrize("id", ["x" * 1_000_000, 10**4000, ["x"] * 100_000, {"x": "y" * 100_000}], ids=range(4))
def test_long_ids(id: Any) -> None:
    """An id that is too long to be kept and repeated is refused, and not repeated in the refusal."""
    with pytest.raises(InvalidOperation) as failed:
        ops.parse({"op": "unsubscribe", "topic": "/t", "id": id})
    assert failed.value.id is ops.ABSENT
    assert len(str(failed.value)) < 1000
