"""Groups of members of the overlay, as the gateways of a robot and its machines run them."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.graph.calls import Request
from ropeway.networks.memory.graph import MemoryGraph
from tests.gateway.test_overlay import Overlay, item
from tests.gateway.test_overlay import overlay as overlay
from tests.graph.parameter_node import ParameterNode
from tests.networks.overlay.conftest import site as site
from tests.support.services import ADD, addends, total
from tests.support.until import PATIENCE_S, until

SET = "rcl_interfaces/srv/SetParameters"
SERVED = {"expose-service": [item("/add", ADD), item("/gpu/set_parameters", SET)]}
STATES = {"standby": None, "service": {"params": [{"/gpu": "watts:=300"}]}}


class Machines:
    """Machines that add, each with a node whose parameters are set; ``calls`` counts what each was asked."""

    def __init__(self, overlay: Overlay) -> None:
        self.overlay = overlay
        self.calls: dict[str, int] = {}
        self.nodes: dict[str, ParameterNode] = {}

    async def start(self, *names: str) -> list[str]:
        """Start machines; return their names in the overlay."""
        for bundle in names:
            graph = await self.overlay.join(bundle, **SERVED)
            name = self.overlay.gateways[-1].status()["remotes"][0]["overlay"]["name"]
            self.calls[name] = 0

            async def add(_: Request, name: str = name) -> bytes:
                self.calls[name] += 1
                return total(1)

            await graph.create_service("/add", ADD, add)
            self.nodes[name] = await ParameterNode({"watts": 10}).serve(graph, "/gpu")
        return list(self.calls)

    async def robot(self, **anycast: Any) -> MemoryGraph:
        """Start a robot that has them as a group, and wait until each is reached."""
        graph = await self.overlay.join("robot", **{"reserve-service": [item("/add", ADD)]}, anycast=anycast)
        await until(lambda: sum(m["here"] for m in self.group["members"].values()) == len(self.calls))
        return graph

    @property
    def group(self) -> dict[str, Any]:
        """The group, as the robot's gateway tells it."""
        found: dict[str, Any] = self.overlay.gateways[-1].status()["remotes"][0].get("group", {"members": {}})
        return found

    def held(self) -> dict[str, str]:
        """Return the state that each machine holds."""
        rows = [gateway.status()["remotes"][0]["overlay"] for gateway in self.overlay.gateways[: len(self.calls)]]
        return {row["name"]: "".join(held["state"] for held in row["states"]) for row in rows}


@pytest.fixture
def machines(overlay: Overlay) -> Machines:
    return Machines(overlay)


async def test_machines_hold_their_states(machines: Machines) -> None:
    """Each machine is told its state over the sealed channel, has its parameters set, and again after a switch."""
    edge1, edge2 = await machines.start("edge1", "edge2")
    await machines.robot(state_definition=STATES, initial_policy={"robot": "robot", edge1: "standby", edge2: "service"})
    await until(lambda: machines.held() == {edge1: "standby", edge2: "service"})
    await until(lambda: [node.values["watts"] for node in machines.nodes.values()] == [10, 300])
    group: Any = machines.overlay.gateways[-1].remotes[0].graph
    group.scheduler.switch(edge1, group.now())
    group.tell()
    await until(lambda: machines.held() == {edge1: "service", edge2: "standby"})
    await until(lambda: machines.nodes[edge1].values["watts"] == 300)


async def test_states_run_out(machines: Machines) -> None:
    """A machine whose robot tells nothing any more holds no state once the lease is over."""
    (edge,) = await machines.start("edge1")
    await machines.robot()
    await until(lambda: machines.held() == {edge: "service"})
    remote: Any = machines.overlay.gateways[-1].remotes[0]
    await remote.states.close()
    await until(lambda: machines.held() == {edge: ""})


@pytest.mark.parametrize(
    ("policy", "asked"), [("one", [10, 10]), ("hedge", [10, 20]), ("all", [20, 20])], ids=["one", "hedge", "all"]
)
async def test_policies(machines: Machines, policy: str, asked: list[int]) -> None:
    """Each call is answered once; all machines are asked with ``all``, and one at a time with ``one``."""
    await machines.start("edge1", "edge2")
    stateless = {"stateless": True} if policy != "one" else {}
    robot = await machines.robot(policy=policy, **stateless)
    client = await robot.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    for _ in range(10):
        await client.call(Request(addends(1)), PATIENCE_S)
    await until(lambda: asked[0] <= sum(machines.calls.values()) <= asked[1])
