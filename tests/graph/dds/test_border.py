"""Networks of other distributions over DDS."""

from __future__ import annotations

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.graph.base import SEQ_NONE, Sample, new_origin
from ropeway.graph.dds.border import Border
from ropeway.graph.factory import make_graph
from ropeway.types import TypeRegistry
from tests.support.inbox import Inbox
from tests.support.until import until

from .conftest import Join

RANGE = "sensor_msgs/msg/Range"
HERE, HUMBLE = TypeRegistry(), TypeRegistry("humble", alone=True)
OURS = HERE.codec(RANGE).encode({"range": 1.25, "variance": 0.5})
THEIRS = HUMBLE.codec(RANGE).encode({"range": 1.25})
WITHOUT = HERE.codec(RANGE).encode({"range": 1.25})


def sample(payload: bytes) -> Sample:
    return Sample(payload, RANGE, 1, new_origin(), SEQ_NONE)


async def test_what_humble_writes_arrives(join: Join) -> None:
    """A message in Humble's layout is read in ours, raw as it goes on."""
    humble, graph = await join("humble"), await join("ours", registry=HERE)
    inbox = Inbox()
    await graph.create_subscription("/range", RANGE, None, inbox)
    publisher = await humble.create_publisher("/range", RANGE)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample(THEIRS))
    publisher.publish(sample(OURS))
    got = await inbox.wait(2)
    assert [HERE.codec(RANGE).encode(HERE.codec(RANGE).decode(one.payload)) for one in got] == [WITHOUT, OURS]


async def test_humble_gets_its_layout(join: Join) -> None:
    """What is written on a network that is said to be of Humble has Humble's layout."""
    humble, graph = await join("humble"), await join("ours", registry=HERE, distro="humble")
    inbox = Inbox()
    await humble.create_subscription("/range", RANGE, None, inbox)
    publisher = await graph.create_publisher("/range", RANGE)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample(OURS))
    (got,) = await inbox.wait(1)
    assert HUMBLE.codec(RANGE).decode(got.payload)["range"] == 1.25
    assert len(got.payload) <= len(THEIRS)


def test_a_network_of_old_nodes_is_recognised() -> None:
    """The layout follows what discovery sees, and types that never changed are not touched at all."""
    old = False
    border = Border(HERE, "", lambda: old)
    convert = border.outward(RANGE)
    assert convert is not None
    assert convert(OURS) == OURS
    old = True
    assert convert(OURS) == THEIRS
    assert convert(b"no message") == b"no message"
    assert border.distro == "humble"
    assert border.outward("std_msgs/msg/String") is None
    assert border.inward("std_msgs/msg/String", print) is print
    assert Border(None, "", lambda: True).outward(RANGE) is None
    assert Border(HERE, "iron", lambda: True).distro == "iron"


def test_distributions_that_are_none() -> None:
    """A distribution that nobody knows is refused with those that there are."""
    for name in ("noetic", "hubmle"):
        with pytest.raises(GraphUnavailable, match=r"no distribution of ROS 2; known are foxy, .*lyrical"):
            make_graph(f"dds:0?distro={name}")
