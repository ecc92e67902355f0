"""ropeway.graph.type_inquiry and type_answers: definitions that one side has, and the other asks for."""

from __future__ import annotations

import itertools
from collections.abc import AsyncIterator
from contextlib import AsyncExitStack

import pytest

from ropeway.errors import CallFailed
from ropeway.graph.calls import Request
from ropeway.graph.type_inquiry import learn
from ropeway.hub.hub import Hub
from ropeway.networks.dds import DdsGraph
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.types import TypeRegistry
from ropeway.types.described import DESCRIPTION_TYPE
from tests.support.until import until

ARM = "my_msgs/msg/Arm"
GRASP = "my_msgs/srv/Grasp"
_domains = itertools.cycle(range(56, 64))


def owner() -> TypeRegistry:
    found = TypeRegistry()
    found.add_text("my_msgs/msg/Part", "string name\n")
    found.add_text(ARM, "uint8 IDLE=0\nuint8 state\nPart[] parts\n")
    found.add_text(GRASP, "Part part\n---\nbool done\n")
    return found


async def refuse(request: Request) -> bytes:
    raise CallFailed("/grasp", "nothing is served here")


class Network:
    """Two participants of a DDS domain; ``theirs`` has the definitions and answers, ``ours`` has not."""

    def __init__(self, stack: AsyncExitStack) -> None:
        self._stack, self._domain = stack, next(_domains)

    async def join(self, registry: TypeRegistry, name: str, *, gateway_id: str = "") -> DdsGraph:
        graph = DdsGraph(self._domain, name=name, interface="lo", registry=registry, gateway_id=gateway_id)
        await graph.open()
        self._stack.push_async_callback(graph.close)
        return graph


@pytest.fixture
async def network() -> AsyncIterator[Network]:
    async with AsyncExitStack() as stack:
        yield Network(stack)


async def test_a_message_is_learnt_once_it_is_discovered(network: Network) -> None:
    """The definition of a message that nobody here knows is asked from the node that publishes it, constants too."""
    ours = TypeRegistry()
    here = await network.join(ours, "here")
    there = await network.join(owner(), "there", gateway_id="theirs")
    await there.create_publisher("/arm", ARM)
    await until(lambda: ours.has(ARM))
    assert ours.hash(ARM) == owner().hash(ARM)
    assert ours.definition(ARM).constants[0].name == "IDLE"
    assert await here.learn(ARM)


async def test_who_needs_it_asks_at_once(network: Network) -> None:
    """``learn`` asks for a type that is discovered, also through a view of a hub, and says whether it is known then."""
    ours = TypeRegistry()
    here = await network.join(ours, "here")
    there = await network.join(owner(), "there", gateway_id="theirs")
    view = Hub(here).view("me")
    assert not await view.learn(ARM)
    await there.create_publisher("/arm", ARM)
    await there.create_service("/grasp", GRASP, refuse)
    await until(lambda: "/arm" in here.topics() and here.types_of("service", "/there/get_type_description"))
    await until(lambda: here.look_up("topic", "/arm").publishers[0].node)
    assert await learn(ARM, view)
    await until(lambda: ours.has(GRASP))
    assert ours.hash(GRASP) == owner().hash(GRASP)


async def test_a_node_that_does_not_tell(network: Network) -> None:
    """A node without the service, or one that does not know, leaves the type unknown, and costs no more than that."""
    ours = TypeRegistry()
    here = await network.join(ours, "here")
    there = await network.join(owner(), "there")
    await there.create_publisher("/arm", ARM)
    await until(lambda: "/arm" in here.topics())
    assert not await here.learn(ARM)
    assert not await here.learn("my_msgs/msg/None")
    assert not await here.learn("my_msgs/action/None")


async def test_what_was_told_is_forgotten_with_the_graph(network: Network) -> None:
    """A definition that a node told is gone once the graph that asked has left."""
    ours = TypeRegistry()
    here = await network.join(ours, "here")
    there = await network.join(owner(), "there", gateway_id="theirs")
    await there.create_publisher("/arm", ARM)
    await until(lambda: ours.has(ARM))
    await here.close()
    assert not ours.has(ARM)


async def test_our_own_are_not_asked_for(network: Network) -> None:
    """What this graph itself publishes is nobody else's to tell."""
    ours = TypeRegistry()
    here = await network.join(ours, "here", gateway_id="ours")
    await here.create_publisher("/arm", ARM)
    assert not await here.learn(ARM)


@pytest.mark.parametrize(
    ("name", "hash", "successful", "reason"),
    [
        (ARM, owner().hash(ARM), True, ""),
        (ARM, "", True, ""),
        (ARM, "RIHS01_" + "0" * 64, False, "another hash"),
        ("sensor_msgs/msg/Range", TypeRegistry("humble").hash("sensor_msgs/msg/Range"), True, ""),
        ("my_msgs/msg/None", "", False, "my_msgs/msg/None"),
        ("no name at all", "", False, "no name at all"),
    ],
)
async def test_answers(network: Network, name: str, hash: str, successful: bool, reason: str) -> None:
    """A gateway's node describes its types, also as other distributions have them, and else says why not."""
    here = await network.join(TypeRegistry(), "here")
    await network.join(owner(), "there", gateway_id="theirs")
    ask, read = (TypeRegistry().codec(f"{DESCRIPTION_TYPE}_{end}") for end in ("Request", "Response"))
    client = await here.create_client("/there/get_type_description", DESCRIPTION_TYPE)
    assert await client.wait_available(60)
    payload = ask.encode({"type_name": name, "type_hash": hash, "include_type_sources": False})
    answer = read.decode(await client.call(Request(payload), 60))
    assert answer["successful"] is successful
    assert reason in answer["failure_reason"]
    assert not answer["type_sources"]


async def test_a_graph_that_cannot_ask() -> None:
    """On a network whose nodes tell nothing a type that is not known stays so."""
    graph = MemoryGraph("types", registry=TypeRegistry())
    await graph.open()
    assert not await learn(ARM, graph)
    assert not await learn(ARM, object())
    await graph.close()
