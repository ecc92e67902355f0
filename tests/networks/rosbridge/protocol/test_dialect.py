from __future__ import annotations

import pytest

from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.codec import ENCODINGS
from ropeway.networks.rosbridge.protocol.dialect import (
    DIALECTS,
    ROPEWAY,
    ROPEWAY_SUBPROTOCOL,
    ROSBRIDGE,
    ROSGW,
    by_subprotocol,
    detect,
)

BRIDGE = "0123456789abcdef0123456789abcdef"


def test_dialects_differ_as_their_programs_do() -> None:
    """Each dialect knows its encodings and habits."""
    assert [str(dialect) for dialect in (ROSBRIDGE, ROSGW, ROPEWAY)] == list(DIALECTS)
    assert ROSBRIDGE.publish == {"none"}
    assert "png" in ROSBRIDGE.subscribe
    assert "zip" not in ROSBRIDGE.subscribe
    assert ROSGW.subscribe == ROSGW.publish == {"none", "cbor", "cbor-raw", "zip", "rawzip"}
    assert ROPEWAY.subscribe == ROPEWAY.publish == set(ENCODINGS)
    assert [d.tagged for d in (ROSBRIDGE, ROSGW, ROPEWAY)] == [True, False, True]
    assert [d.names_compression for d in (ROSBRIDGE, ROSGW, ROPEWAY)] == [False, True, True]
    assert [d.records for d in (ROSBRIDGE, ROSGW, ROPEWAY)] == [False, False, True]


def test_the_subprotocol_tells_ropeway() -> None:
    """Only the subprotocol makes a peer a Ropeway gateway."""
    assert ROPEWAY_SUBPROTOCOL == "ropeway.1"
    assert by_subprotocol("ropeway.1") is ROPEWAY
    for other in (None, "", "ropeway.2", "v1.rosbridge"):
        assert by_subprotocol(other) is ROSBRIDGE


ROSGW_SIGNS: list[ops.Op] = [
    ops.Advertise(topic="/t", type="a/B", compression="cbor"),
    ops.Publish(topic="/t", msg={}, compression="none"),
    ops.Subscribe(topic="/t", compression="zip"),
    ops.Subscribe(topic="/t", compression="rawzip"),
    ops.AdvertiseService(service="/s", type="a/B", compression="cbor"),
    ops.ServiceResponse(service="/s", values={}, result=True, compression="cbor"),
    ops.Advertise(topic="/t", type="a/B", id=f"advertise:{BRIDGE}:1"),
    ops.Subscribe(topic="/t", type="a/B", id=f"subscribe:{BRIDGE}:12", compression="cbor"),
    ops.AdvertiseAction(action="/a", type="a/B", id=f"exposeact:{BRIDGE}:3"),
    ops.UnadvertiseService(service="/s", id=f"delsrv:{BRIDGE}:4"),
]
NO_SIGNS: list[ops.Op] = [
    ops.Advertise(topic="/t", type="a/B", id="advertise:/t:1"),
    ops.Subscribe(topic="/t", compression="cbor"),
    ops.Subscribe(topic="/t", compression="cbor-raw", id="subscribe:/t:1"),
    ops.Subscribe(topic="/t", id=7),
    ops.CallService(service="/s", args={}, compression="none"),
    ops.SendActionGoal(action="/a", action_type="a/B", args={}, compression="none"),
    ops.Fragment(id="1", data="", num=0, total=1),
]


@pytest.mark.parametrize("op", ROSGW_SIGNS, ids=str)
def test_a_plain_peer_shows_that_it_is_rosgw(op: ops.Op) -> None:
    """What only rosgw does makes a plain peer rosgw, and leaves other dialects alone."""
    assert detect(ROSBRIDGE, op) is ROSGW
    assert detect(ROSGW, op) is ROSGW
    assert detect(ROPEWAY, op) is ROPEWAY


@pytest.mark.parametrize("op", NO_SIGNS, ids=str)
def test_a_rosbridge_client_stays_one(op: ops.Op) -> None:
    """What rosbridge's own clients do is no sign of rosgw, and a rosgw peer stays one."""
    assert detect(ROSBRIDGE, op) is ROSBRIDGE
    assert detect(ROSGW, op) is ROSGW
