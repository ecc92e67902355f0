"""ropeway.networks.overlay.membership: who is there, whatever the clocks say."""

from __future__ import annotations

import time
from collections.abc import Callable

import pytest

from ropeway.qos import QoS
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.networks.overlay.fleet import member
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample
from tests.support.until import until

HOUR_NS = 3600 * 10**9


def off(by_ns: int) -> Callable[[], int]:
    """Return a clock that is wrong."""
    return lambda: time.time_ns() + by_ns


@pytest.mark.parametrize("by_ns", [HOUR_NS, -HOUR_NS], ids=["ahead", "behind"])
async def test_clocks_an_hour_apart(site: Site, by_ns: int) -> None:
    """A member whose clock is wrong takes part, and its status and the others' tell by how much."""
    right, wrong = await site.join(member("right")), await site.join(member("wrong"), clock_ns=off(by_ns))
    inbox, back = Inbox(), Inbox()
    await right.create_subscription("/a", STRING, QoS(), inbox)
    await wrong.create_subscription("/b", STRING, QoS(), back)
    there, here = await wrong.create_publisher("/a", STRING), await right.create_publisher("/b", STRING)
    await until(lambda: there.subscribers and here.subscribers)
    there.publish(sample("from the wrong one"))
    here.publish(sample("from the right one"))
    await inbox.wait(1)
    await back.wait(1)
    for graph, ahead_s in ((right, by_ns / 1e9), (wrong, -by_ns / 1e9)):
        (row,) = graph.node.status()["gateways"]
        assert row["clock_ahead_s"] == pytest.approx(ahead_s, abs=30)
        assert not graph.node.refusals
