"""ropeway.networks.overlay.states: machines are told their states, and hold them."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.errors import RopewayError
from ropeway.networks.overlay.rpc import RemoteError
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.networks.overlay.fleet import member
from tests.support.until import until


async def test_the_last_state_counts(site: Site) -> None:
    """Of states that are told one right after the other the last is held, whatever became of the others."""
    robot, edge = (await site.join(member("robot"))).node, (await site.join(member("edge"))).node
    await until(lambda: edge.gateway in robot.membership.gateways())
    for state in ("standby", "service", "standby", "service"):
        robot.states.tell(edge.gateway, "edges", state)
    held = [{"robot": robot.identity.name, "group": "edges", "state": "service"}]
    await until(lambda: edge.status()["states"] == held)


async def test_a_gateway_that_is_not_there(site: Site) -> None:
    """A state for a gateway that has gone is lost, and the next one for it is sent again."""
    robot = (await site.join(member("robot"))).node
    robot.states.tell(bytes(16), "edges", "service")
    await until(lambda: not robot.states.pending)
    robot.states.tell(bytes(16), "edges", "service")
    assert robot.states.pending


@pytest.mark.parametrize(
    "wrong", [{"state": ""}, {"state": 5}, {"group": "x" * 300}, {"lease_s": 1e9}, {"lease_s": True}, {"group": None}]
)
async def test_what_is_no_state(site: Site, wrong: dict[str, Any]) -> None:
    """What is no state is refused with the reason, and nothing is held."""
    robot, edge = (await site.join(member("robot"))).node, (await site.join(member("edge"))).node
    await until(lambda: edge.gateway in robot.membership.gateways())
    request = {"op": "state", "group": "edges", "state": "service", "lease_s": 3.0} | wrong
    with pytest.raises(RopewayError) as caught:
        await robot.rpc.ask(edge.gateway, request, 10.0)
    assert isinstance(caught.value, RemoteError)
    assert next(iter(wrong)) in caught.value.text
    assert edge.status()["states"] == []
