"""The frames of the protocol: those of viewers are read and checked, those of the server are made."""

from __future__ import annotations

import json
import struct
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import InvalidFrame, InvalidOperation
from ropeway.limits import (
    ASSET_URI_CHARACTERS,
    ID_CHARACTERS,
    NAME_CHARACTERS,
    VIEWER_ITEMS_PER_OPERATION,
    VIEWER_PARAMETER_CHARACTERS,
)
from ropeway.networks.foxglove import wire


def read(operation: dict[str, Any]) -> wire.ViewerOperation:
    """Read an operation as a viewer sends it."""
    return wire.read_text(json.dumps(operation).encode())


OFFER = {"id": 1, "topic": "/a", "encoding": "cdr", "schemaName": "std_msgs/msg/String"}


@pytest.mark.parametrize(
    ("operation", "expected"),
    [
        (
            {"op": "subscribe", "subscriptions": [{"id": 0, "channelId": 2**32 - 1}]},
            wire.ReadChannels(((0, 2**32 - 1),)),
        ),
        ({"op": "unsubscribe", "subscriptionIds": [1, 2]}, wire.LeaveChannels((1, 2))),
        (
            {"op": "advertise", "channels": [OFFER]},
            wire.OfferChannels((wire.ChannelOffer(1, "/a", "cdr", "std_msgs/msg/String", "", ""),)),
        ),
        (
            {"op": "advertise", "channels": [{**OFFER, "schema": "string data", "schemaEncoding": "ros2msg"}]},
            wire.OfferChannels((wire.ChannelOffer(1, "/a", "cdr", "std_msgs/msg/String", "string data", "ros2msg"),)),
        ),
        ({"op": "unadvertise", "channelIds": []}, wire.WithdrawChannels(())),
        ({"op": "getParameters", "parameterNames": ["/n.a", "/n.a"], "id": "7"}, wire.GetParameters(("/n.a",), "7")),
        ({"op": "getParameters", "parameterNames": []}, wire.GetParameters((), None)),
        (
            {"op": "setParameters", "parameters": [{"name": "/n.a", "value": 5, "type": "float64"}], "id": "x"},
            wire.SetParameters((wire.GivenParameter("/n.a", 5, "float64", True),), "x"),
        ),
        (
            {"op": "setParameters", "parameters": [{"name": "/n.a"}]},
            wire.SetParameters((wire.GivenParameter("/n.a", None, "", False),), None),
        ),
        (
            {"op": "subscribeParameterUpdates", "parameterNames": ["/n.a"]},
            wire.WatchParameters(("/n.a",), True, "subscribeParameterUpdates"),
        ),
        (
            {"op": "unsubscribeParameterUpdates", "parameterNames": ["/n.a"]},
            wire.WatchParameters(("/n.a",), False, "unsubscribeParameterUpdates"),
        ),
        ({"op": "subscribeConnectionGraph"}, wire.WatchGraph(True, "subscribeConnectionGraph")),
        ({"op": "unsubscribeConnectionGraph"}, wire.WatchGraph(False, "unsubscribeConnectionGraph")),
        ({"op": "fetchAsset", "uri": "package://a/b.stl", "requestId": 3}, wire.FetchAsset("package://a/b.stl", 3)),
    ],
    ids=lambda value: value["op"] if isinstance(value, dict) else "",
)
def test_operations(operation: dict[str, Any], expected: wire.ViewerOperation) -> None:
    """Every operation of the protocol is read with all that it says."""
    assert read(operation) == expected


@pytest.mark.parametrize(
    "operation",
    [
        {"op": "subscribe", "subscriptions": [{"id": 1}]},
        {"op": "subscribe", "subscriptions": [{"id": 1.0, "channelId": 1}]},
        {"op": "subscribe", "subscriptions": [{"id": 2**32, "channelId": 1}]},
        {"op": "unsubscribe", "subscriptionIds": [[1]]},
        {"op": "unsubscribe", "subscriptionIds": [1] * (VIEWER_ITEMS_PER_OPERATION + 1)},
        {"op": "advertise", "channels": [{**OFFER, "topic": "/" + "a" * NAME_CHARACTERS}]},
        {"op": "advertise", "channels": [{**OFFER, "encoding": 7}]},
        {"op": "advertise", "channels": [{**OFFER, "schemaName": None}]},
        {"op": "getParameters", "parameterNames": [7]},
        {"op": "getParameters", "parameterNames": ["a" * (VIEWER_PARAMETER_CHARACTERS + 1)]},
        {"op": "getParameters", "parameterNames": [], "id": "a" * (ID_CHARACTERS + 1)},
        {"op": "setParameters", "parameters": [{"name": "/n.a", "value": 1, "type": "complex"}]},
        {"op": "setParameters", "parameters": [{"value": 1}]},
        {"op": "fetchAsset", "uri": "a" * (ASSET_URI_CHARACTERS + 1), "requestId": 1},
        {"op": "fetchAsset", "uri": "a", "requestId": True},
        {"op": "serverInfo"},
        {"op": ["subscribe"]},
        {},
    ],
    ids=str,
)
def test_operations_that_are_none(operation: dict[str, Any]) -> None:
    """An operation of a wrong shape or size is refused with its name."""
    with pytest.raises(InvalidOperation):
        read(operation)


def test_binary_frames() -> None:
    """A message and a service call are read with all that they carry, an empty body too."""
    assert wire.read_binary(b"\x01\x07\0\0\0body") == wire.ViewerMessage(7, b"body")
    assert wire.read_binary(memoryview(b"\x01\xff\xff\xff\xff")) == wire.ViewerMessage(2**32 - 1, b"")
    call = struct.pack("<BIII", 2, 3, 4, 4) + b"jsonbody"
    assert wire.read_binary(call) == wire.ViewerCall(3, 4, "json", b"body")


@given(st.binary(max_size=64))
def test_any_binary_frame(data: bytes) -> None:
    """Any bytes are a frame of a viewer or are refused as none."""
    try:
        got = wire.read_binary(data)
    except InvalidFrame:
        return
    assert isinstance(got, wire.ViewerMessage | wire.ViewerCall)


def test_frames_of_the_server() -> None:
    """What the server sends is laid out as the protocol has it."""
    assert wire.message_prefix(9) == b"\x01\x09\0\0\0"
    assert len(wire.message_prefix(9)) + 8 == wire.MESSAGE_HEADER_BYTES
    assert wire.time_frame(258) == b"\x02\x02\x01\0\0\0\0\0\0"
    assert wire.service_response(1, 2, "cdr", b"x") == b"\x03\x01\0\0\0\x02\0\0\0\x03\0\0\0cdrx"
    assert wire.asset_found(5, b"mesh") == b"\x04\x05\0\0\0\0\0\0\0\0mesh"
    assert wire.asset_error(5, "no") == b"\x04\x05\0\0\0\x01\x02\0\0\0no"
