"""ropeway.networks.rosbridge.protocol.plain_calls: what is read at once is read as all else."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.limits import ID_CHARACTERS, NAME_CHARACTERS
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.plain_calls import plain_call, plain_response

CALL: dict[str, Any] = {
    "op": "call_service",
    "id": "call_service:/add:1",
    "service": "/add",
    "type": "example_interfaces/srv/AddTwoInts",
    "timeout": 5.0,
    "ropeway": {"call": "ab" * 16, "via": ["us"]},
    "compression": "cbor-raw",
    "args": b"\0\1\0\0",
}
RESPONSE: dict[str, Any] = {
    "op": "service_response",
    "id": "call_service:/add:1",
    "service": "/add",
    "values": b"\0\1\0\0",
    "result": True,
    "compression": "zstd",
}


def without(message: dict[str, Any], key: str) -> dict[str, Any]:
    return {k: value for k, value in message.items() if k != key}


@pytest.mark.parametrize("call", [CALL, without(CALL, "type"), without(CALL, "args"), without(CALL, "compression")])
def test_calls_of_gateways(call: dict[str, Any]) -> None:
    """A call that is read at once is the same as one whose fields are judged one by one."""
    assert plain_call(call) == ops.parse({**call, "fragment_size": 0})


@pytest.mark.parametrize("response", [RESPONSE, without(RESPONSE, "values"), without(RESPONSE, "compression")])
def test_responses_of_gateways(response: dict[str, Any]) -> None:
    """A response that is read at once is the same as one whose fields are judged one by one."""
    assert plain_response(response) == ops.parse({**response, "ropeway": None})


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("id", 7),
        ("id", None),
        ("id", "x" * (ID_CHARACTERS + 1)),
        ("service", None),
        ("service", "/" + "x" * NAME_CHARACTERS),
        ("type", 1),
        ("timeout", 5),
        ("timeout", 0.0),
        ("timeout", float("nan")),
        ("timeout", float("inf")),
        ("ropeway", None),
        ("ropeway", "x"),
        ("compression", "zip"),
        ("compression", {}),
        ("fragment_size", 100),
    ],
)
def test_other_calls_are_left_to_those_who_judge(key: str, value: object) -> None:
    """A call with anything unusual is not read at once."""
    assert plain_call({**CALL, key: value}) is None


@pytest.mark.parametrize(
    ("key", "value"),
    [("id", 7), ("service", 1), ("result", False), ("result", 1), ("compression", "png"), ("ropeway", {"error": "x"})],
)
def test_other_responses_are_left_to_those_who_judge(key: str, value: object) -> None:
    """A response with anything unusual is not read at once."""
    assert plain_response({**RESPONSE, key: value}) is None
