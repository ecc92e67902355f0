"""Names as clients write them."""

from __future__ import annotations

import pytest

from ropeway.errors import InvalidName
from ropeway.networks.rosbridge.server.names import Names
from tests.support.messages import STRING
from tests.support.place import Place
from tests.support.until import until

pytestmark = pytest.mark.jumping

NAMES = Names("/bridges/rosbridge")


@pytest.mark.parametrize(
    ("name", "full"),
    [
        ("chatter", "/chatter"),
        ("/a/b", "/a/b"),
        ("~/x", "/bridges/rosbridge/x"),
        ("~", "/bridges/rosbridge"),
        ("{node}/x", "/rosbridge/x"),
        ("/robot/{node}/x", "/robot/rosbridge/x"),
        ("{ns}/x", "/bridges/x"),
        ("{namespace}/x", "/bridges/x"),
    ],
)
def test_names_of_clients(name: str, full: str) -> None:
    """Private names and substitutions stand for those of our node."""
    assert NAMES.resolve(name) == full


def test_root_namespace() -> None:
    """The namespace of a node at the root adds no slash."""
    assert Names("/bridge").resolve("{ns}/x") == "/x"


@pytest.mark.parametrize("name", ["~x", "a/~/x", "{nodes}/x", "{", "~/", "~//x", "", "~/" + "x" * 3000, None, "/~"])
def test_names_that_are_none(name: str) -> None:
    """What ROS 2 refuses is refused."""
    with pytest.raises(InvalidName):
        NAMES.resolve(name)


def test_private_names_of_ros1() -> None:
    """In ROS 1 no slash follows the ~."""
    assert Names("/bridge", ros1=True).resolve("~x") == "/bridge/x"


async def test_a_client_uses_private_names(bare: Place) -> None:
    """What a client publishes and reads under private names is on the network under those of our node."""
    await bare.start(node="rosbridge_websocket")
    client = await bare.client()
    client.send({"op": "subscribe", "topic": "~/in", "type": STRING})
    client.send({"op": "advertise", "topic": "~/out", "type": STRING})
    await until(lambda: {"/rosbridge_websocket/in", "/rosbridge_websocket/out"} <= bare.robot.topics().keys())
