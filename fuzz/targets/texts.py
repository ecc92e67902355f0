"""Short texts of peers: names, QoS objects, what robots say, values of parameters."""

from __future__ import annotations

import math
from typing import Final

from fuzz.target import Target
from fuzz.targets.nested import NESTED_CBOR, NESTED_JSON
from ropeway.errors import InvalidFrame, InvalidName, InvalidTypeName, TypesError
from ropeway.gateway.config.address import parse_graph, parse_link, parse_listen
from ropeway.gateway.config.auth_model import parse_glob
from ropeway.graph.base import resolve_name
from ropeway.graph.parameters import ParameterType, to_message
from ropeway.networks.rosbridge.client.call_notes import read_note
from ropeway.networks.rosbridge.rosapi.params import _fitted, from_json, to_json
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from ropeway.types.definition import canonical_name
from ropeway.types.forms import FORMS, Form, make_form
from ropeway.types.untrusted import cbor_loads, json_loads

__all__ = ["TARGETS"]


def _names(data: bytes) -> None:
    text = data.decode(errors="replace")
    for read in (resolve_name, canonical_name, parse_link, parse_listen, parse_graph, parse_glob):
        try:
            read(text)  # type: ignore[operator]
        except (InvalidName, InvalidTypeName, ValueError):
            continue


def _qos(data: bytes) -> None:
    """The ``qos`` and ``ropeway`` objects of operations."""
    value = json_loads(data[1:]) if data[:1] == b"j" else cbor_loads(data[1:])
    if isinstance(value, dict):
        assert len(read_note(value).id) == 16
    found = QoS.parse(value)
    assert found.depth >= 0
    assert all(time is None or (time >= 0 and math.isfinite(time)) for time in (found.deadline_s, found.lifespan_s))


def _forms() -> list[Form]:
    registry, twist = TypeRegistry(), "geometry_msgs/msg/Twist"
    codes = {"codes": {"F": {"linear.x": 1.0}, "S": {}}}
    made = [make_form(form, twist, registry, codes, clock=lambda: 0.0) for form in FORMS if form not in ("text", "raw")]
    plain = (
        "std_msgs/msg/String",
        "std_msgs/msg/Int8",
        "std_msgs/msg/UInt64",
        "std_msgs/msg/Bool",
        "std_msgs/msg/Float32",
    )
    made += [make_form("text", type, registry, {}, clock=lambda: 0.0) for type in plain]
    made.append(make_form("raw", "std_msgs/msg/UInt8MultiArray", registry, {}, clock=lambda: 0.0))
    fields = {"fields": {"linear.x": "a.0.b", "angular.z": "c"}}
    return [*made, make_form("json", twist, registry, fields, clock=lambda: 0.0)]


_FORMS: Final = _forms()


def _robot(data: bytes) -> None:
    """A form by the first byte, then what the robot says."""
    form = _FORMS[data[0] % len(_FORMS)] if data else _FORMS[0]
    for after_s, payload in form.messages(data[1:]):
        assert math.isfinite(after_s)
        form.text(payload)


def _parameter(data: bytes) -> None:
    """What a client sets, by the type that the node has."""
    text = data[1:].decode(errors="replace")
    kind = ParameterType(data[0] % len(ParameterType)) if data else ParameterType.NOT_SET
    given = from_json(text)
    to_message(_fitted(given, text, kind))
    to_json(given)


TARGETS: Final = {
    "names": Target(
        _names,
        (),
        lambda: [
            b"/a/b_1",
            b"std_msgs/msg/String",
            b"ws://host:9090/x?token=1",
            b"dds:0?interface=lo",
            b"['/a','/b*']",
        ],
        (b"://", b"//", b"dds:", b"ros1:http://", b"iorts://", b"[::1]", b"~", b"*"),
    ),
    "qos": Target(
        _qos,
        (InvalidFrame, ValueError),
        lambda: [
            b'j{"history":"keep_last","depth":5,"reliability":"reliable","durability":"volatile","deadline":1}',
            *(b"j" + value for value in NESTED_JSON),
            *(b"c" + value for value in NESTED_CBOR),
            b'j{"lifespan":{"secs":1,"nsecs":2},"call":"00","via":["a"],"caller":"b","encoding":"cbor"}',
        ],
        (b'"infinite"', b"1e999", b"NaN", b'"secs"', b'"nsecs"', b"9" * 400),
    ),
    "robot-texts": Target(
        _robot,
        (TypesError,),
        lambda: [
            bytes((n,)) + t
            for n, t in enumerate((b"1,0,0,0,0,2", b"{}", b"F", b"90", b"x", b"5", b"7", b"true", b"1e9"))
        ],
        (b"inf", b"1e400", b"1_0", b"NaN", b"\xd9\xa3", b"0x1", b"null", b'{"linear":{"x":', b'{"a":[{"b":1}]}'),
    ),
    "parameter-values": Target(
        _parameter,
        (),
        lambda: [b"\0" + t for t in (*NESTED_JSON, b"[1, 2]", b"true", b'"!!binary x"', b'"2024-01-01"', b'"&a [*a]"')],
        (b"&a ", b"*a", b"!!", b"? ", b'"[', b'"'),
    ),
}
