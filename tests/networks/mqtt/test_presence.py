"""ropeway.networks.mqtt.presence: what gateways at a broker tell each other."""

from __future__ import annotations

import orjson
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.limits import MQTT_PRESENCE_BYTES, MQTT_PRESENCE_ENDPOINTS
from ropeway.networks.mqtt.presence import Announced, id_of, pack_announcement, parse_announcement
from ropeway.qos import LATCHED, SENSOR_DATA
from tests.support.messages import STRING

_JSON = st.recursive(
    st.none() | st.booleans() | st.floats() | st.text(max_size=5) | st.sampled_from(["p", "s", "/n", STRING]),
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=9), inner, max_size=4),
    max_leaves=12,
)


def test_there_and_back() -> None:
    """An announcement is read as it was written."""
    ends = (Announced("publisher", "a/b", STRING, LATCHED), Announced("subscription", "c/+", STRING, SENSOR_DATA))
    found = parse_announcement(pack_announcement("/robot", ends))
    assert found is not None
    assert (found.node, found.endpoints) == ("/robot", ends)


@given(st.binary(max_size=200))
def test_bytes(payload: bytes) -> None:
    """Any bytes are an announcement or none."""
    found = parse_announcement(payload)
    assert found is None or found.node.startswith("/")


@given(st.lists(_JSON, max_size=3) | st.just([["p", "a", STRING, {}]]))
def test_rows(rows: list[object]) -> None:
    """Of any rows those that are endpoints are taken."""
    found = parse_announcement(orjson.dumps({"node": "/n", "endpoints": rows}))
    assert found is not None
    assert all(end.kind in ("publisher", "subscription") and end.topic for end in found.endpoints)


def test_bounds() -> None:
    """Of too many endpoints as many are told as others read, and a longer announcement is not read."""
    ends = [Announced("publisher", f"t/{number}", STRING, LATCHED) for number in range(MQTT_PRESENCE_ENDPOINTS + 10)]
    payload = pack_announcement("/n", ends)
    found = parse_announcement(payload)
    assert found is not None
    assert 1000 < len(found.endpoints) <= MQTT_PRESENCE_ENDPOINTS
    assert len(payload) <= MQTT_PRESENCE_BYTES
    assert parse_announcement(payload.ljust(MQTT_PRESENCE_BYTES + 1)) is None


@pytest.mark.parametrize(
    ("topic", "id"), [("ropeway/" + "a" * 32, "a" * 32), ("ropeway/a", ""), ("other/" + "a" * 32, ""), ("a" * 32, "")]
)
def test_ids(topic: str, id: str) -> None:
    """Only topics directly below that of announcements are announcements."""
    assert id_of(topic, "ropeway") == id
