"""Gateways that meet in the overlay, each with a network of its own."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from ropeway.graph.calls import ActionHandlers, Goal, GoalStatus, Outcome, Request, ServerGoal
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.overlay.crypto.identity import write_private
from ropeway.networks.overlay.crypto.seal import Opened, Opener, PacketHeader, peek
from ropeway.qos import LATCHED, QoS
from tests.networks.overlay.conftest import Site
from tests.networks.overlay.conftest import site as site
from tests.networks.overlay.fleet import member
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.until import PATIENCE_S, until
from tests.support.world import World

from .test_calls import ADD, FIBONACCI, add, pair, sequence, total


class Overlay:
    """Gateways that are members, behind one router."""

    def __init__(self, world: World, site: Site, directory: Path) -> None:
        self.world, self.site, self.directory = world, site, directory
        self.gateways: list[Gateway] = []
        self.options: dict[str, dict[str, Any]] = {}  # of gateway.overlay, by member

    async def join(self, name: str, **remote: Any) -> MemoryGraph:
        """A gateway with one remote, the overlay; gives a robot on its network."""
        bundle = self.directory / f"{name}.ropeway"
        write_private(bundle, member(name).to_text())
        overlay = {"identity": str(bundle), "routers": [self.site.endpoint], "listen": [], **self.options.get(name, {})}
        gateway = await self.world.gateway(
            name, [{"address": "overlay", **remote}], overlay=overlay, listen=[], insecure=True
        )
        self.gateways.append(gateway)
        return await self.world.robot(name)


@pytest.fixture
def overlay(world: World, site: Site, tmp_path: Path) -> Overlay:
    return Overlay(world, site, tmp_path)


def item(name: str, type: str = STRING, **more: Any) -> dict[str, Any]:
    return {"name": name, "type": type, **more}


async def test_topics_both_ways(overlay: Overlay) -> None:
    """What one gateway publishes to the overlay another subscribes from it, with its QoS, renamed where asked."""
    robot = await overlay.join("robot", publish=[item("/map", remote_name="/robot/map")], subscribe=[item("/cmd")])
    cloud = await overlay.join("cloud", subscribe=[item("/robot/map")], publish=[item("/cmd")])
    maps, commands = Inbox(), Inbox()
    publisher = await robot.create_publisher("/map", STRING, LATCHED)
    publisher.publish(sample("kept"))
    await cloud.create_subscription("/robot/map", STRING, None, maps)
    await maps.wait(1, 30)
    await until(lambda: [p.qos.transient_local for p in cloud.topics()["/robot/map"].publishers] == [True])
    await robot.create_subscription("/cmd", STRING, QoS(), commands)
    order = await cloud.create_publisher("/cmd", STRING)
    await until(lambda: order.subscribers)
    row = overlay.gateways[0].status()
    assert row["remotes"][0]["state"] == "connected"
    assert [g["name"] for g in row["remotes"][0]["overlay"]["gateways"]] != []
    await until(lambda: overlay.gateways[1].status()["routes"][0]["state"] == "active")
    order.publish(sample("go"))
    await commands.wait(1, 30)


@pytest.mark.parametrize("cloud_says", ["session", "signed"])
async def test_authenticity(overlay: Overlay, monkeypatch: pytest.MonkeyPatch, cloud_says: str) -> None:
    """Gateways that both say ``session`` prove messages to each other; where one says ``signed`` they are signed."""
    heads: list[PacketHeader] = []
    opening = Opener.open

    def opened(opener: Opener, packet: bytes) -> Opened:
        heads.append(peek(packet))
        return opening(opener, packet)

    monkeypatch.setattr(Opener, "open", opened)
    overlay.options = {"robot": {"authenticity": "session"}, "cloud": {"authenticity": cloud_says}}
    robot = await overlay.join("robot", publish=[item("/map")])
    cloud = await overlay.join("cloud", subscribe=[item("/map")])
    maps = Inbox()
    await cloud.create_subscription("/map", STRING, LATCHED, maps)
    publisher = await robot.create_publisher("/map", STRING, LATCHED)
    await until(lambda: overlay.gateways[1].status()["routes"][0]["state"] == "active")
    while not heads:  # the first messages may come as history
        before = len(maps.samples)
        publisher.publish(sample("here"))
        await maps.wait(before + 1, 30)
    assert {(head.session, head.signed) for head in heads} == {(cloud_says == "session", cloud_says == "signed")}


async def test_services_and_actions(overlay: Overlay) -> None:
    """A service and an action that one gateway exposes are reserved by another, and used as if they were local."""
    types = {"expose-service": [item("/add", ADD)], "expose-action": [item("/fib", FIBONACCI)]}
    robot = await overlay.join("robot", **types)
    cloud = await overlay.join("cloud", **{key.replace("expose", "reserve"): value for key, value in types.items()})
    await robot.create_service("/add", ADD, add)

    async def execute(goal: ServerGoal) -> Outcome:
        goal.feedback(sequence(1))
        return Outcome(GoalStatus.SUCCEEDED, sequence(1, 1, 2))

    await robot.create_action_server("/fib", FIBONACCI, ActionHandlers(execute))
    client = await cloud.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)
    assert total(await client.call(Request(pair(40, 2)), 10)) == 42
    user = await cloud.create_action_client("/fib", FIBONACCI)
    assert await user.wait_available(PATIENCE_S)
    heard: list[bytes] = []
    goal = await user.send_goal(Goal(b"\0\1\0\0\3\0\0\0"), on_feedback=heard.append, timeout_s=10)
    outcome = await goal.result(PATIENCE_S)
    assert (outcome.status, outcome.payload) == (GoalStatus.SUCCEEDED, sequence(1, 1, 2))
    await until(lambda: heard == [sequence(1)])


async def test_automatic(overlay: Overlay) -> None:
    """A topic with publishers here is offered, one with readers here is fetched; both or none are left alone."""
    shared = {"automatic": {"allow": ["/shared/*", "/both"], "deny": ["/shared/secret"]}}
    robot, cloud = await overlay.join("robot", **shared), await overlay.join("cloud", **shared)
    inbox = Inbox()
    publisher = await robot.create_publisher("/shared/a", STRING)
    for name in ("/shared/secret", "/private"):
        await robot.create_publisher(name, STRING)
    await robot.create_publisher("/both", STRING)
    await robot.create_subscription("/both", STRING, QoS(), lambda _: None)
    reader = await cloud.create_subscription("/shared/a", STRING, QoS(), inbox)
    await until(lambda: publisher.subscribers)
    publisher.publish(sample("hello"))
    await inbox.wait(1, 30)
    offered = {row["name"]: row["operation"] for row in overlay.gateways[0].status()["routes"]}
    fetched = {row["name"]: row["operation"] for row in overlay.gateways[1].status()["routes"]}
    assert (offered, fetched) == ({"/shared/a": "publish"}, {"/shared/a": "subscribe"})
    await reader.close()
    await until(lambda: not overlay.gateways[1].status()["routes"])
    await robot.create_subscription("/shared/a", STRING, QoS(), lambda _: None)
    await until(lambda: not overlay.gateways[0].status()["routes"])
    await publisher.close()
    await until(lambda: [r["operation"] for r in overlay.gateways[0].status()["routes"]] == ["subscribe"])


async def test_nothing_is_allowed(overlay: Overlay) -> None:
    """Without anything allowed, automatic mode shares nothing."""
    robot = await overlay.join("robot", automatic={})
    watcher = await overlay.join("cloud", automatic={"allow": ["*"]})
    await robot.create_publisher("/a", STRING)
    publisher = await watcher.create_publisher("/b", STRING)
    await until(lambda: overlay.gateways[1].status()["routes"])
    assert overlay.gateways[0].status()["routes"] == []
    assert publisher.subscribers == 0


async def test_metadata_of_one_item(overlay: Overlay) -> None:
    """A topic, a service and an action with metadata of their own are others than those without, and told with them."""
    about = {"author": "ann", "unique": "cell 7"}
    served = {"expose-service": [item("/add", ADD, **about)], "expose-action": [item("/fib", FIBONACCI, **about)]}
    robot = await overlay.join("robot", publish=[item("/map", **about)], **served)
    taken = {key.replace("expose", "reserve"): value for key, value in served.items()}
    cloud = await overlay.join("cloud", subscribe=[item("/map", **about)], **taken)
    plain = await overlay.join("plain", subscribe=[item("/map")])
    inbox, none = Inbox(), Inbox()
    await cloud.create_subscription("/map", STRING, QoS(), inbox)
    await plain.create_subscription("/map", STRING, QoS(), none)
    publisher = await robot.create_publisher("/map", STRING)
    await until(lambda: publisher.subscribers)
    publisher.publish(sample("here"))
    await inbox.wait(1, 30)
    assert none.samples == []
    node = overlay.gateways[1].node
    assert node is not None
    (advert,) = (advert for advert in node.rib.all("publisher") if advert.name == "/map")
    assert (advert.metadata.author, advert.metadata.unique, advert.node) == ("ann", "cell 7", "robot")
    await robot.create_service("/add", ADD, add)
    client = await cloud.create_client("/add", ADD)
    assert await client.wait_available(PATIENCE_S)

    async def execute(goal: ServerGoal) -> Outcome:
        return Outcome(GoalStatus.SUCCEEDED, sequence(1, 1, 2))

    await robot.create_action_server("/fib", FIBONACCI, ActionHandlers(execute))
    user = await cloud.create_action_client("/fib", FIBONACCI)
    assert await user.wait_available(PATIENCE_S)


@pytest.mark.parametrize(
    ("remote", "gateway", "path", "said"),
    [
        ({"address": "overlay"}, {}, "remotes[0].address", "ropeway keys issue"),
        ({"address": "ws://a", "automatic": {}}, {}, "remotes[0].automatic", '"address": "overlay"'),
        ({"address": "ws://a", "unique": "x"}, {}, "remotes[0].unique", '"address": "overlay"'),
        (
            {"address": "ws://a", "publish": [{"name": "/x", "type": STRING, "unique": "y"}]},
            {},
            "remotes[0].publish[0].unique",
            '"address": "overlay"',
        ),
        ({"address": "overlay", "token": {"env": "X"}}, {}, "remotes[0].token", "certificates say who is who"),
        ({"address": "overlay", "automatic": {"allow": ["camera"]}}, {}, "remotes[0].automatic.allow[0]", "/camera/*"),
        ({"address": "ws://a"}, {"overlay": {"identity": "nowhere"}}, "gateway.overlay.identity", "existing file"),
        (
            {"address": "ws://a"},
            {"overlay": {"identity": __file__, "authenticity": "none"}},
            "gateway.overlay.authenticity",
            "session",
        ),
        (
            {"address": "ws://a"},
            {"overlay": {"identity": __file__, "routers": ["tcp/a:1"]}},
            "gateway.overlay.routers[0]",
            "tls/router.example:7447",
        ),
    ],
)
def test_faults(remote: dict[str, Any], gateway: dict[str, Any], path: str, said: str) -> None:
    """What does not go together is told with its path and what to write."""
    with pytest.raises(ConfigError) as caught:
        config.parse({"gateway": gateway, "remotes": [remote]})
    assert said in dict(caught.value.problems)[path]


async def test_a_group_of_members(overlay: Overlay) -> None:
    """Of two members that offer the same one gets each message and call of a robot, and the other those after it."""
    machine = {"subscribe": [item("/input")], "expose-service": [item("/add", ADD)]}
    heard: dict[str, Inbox] = {}
    networks: dict[str, MemoryGraph] = {}
    for name in ("edge", "cloud"):
        node = networks[name] = await overlay.join(name, **machine)
        heard[name] = Inbox()
        await node.create_subscription("/input", STRING, None, heard[name])
        await node.create_service("/add", ADD, add)
    robot = await overlay.join(
        "robot", anycast={}, publish=[item("/input")], **{"reserve-service": [item("/add", ADD)]}
    )

    def group() -> dict[str, Any]:
        found: dict[str, Any] = overlay.gateways[-1].status()["remotes"][0]["group"]
        return found

    await until(lambda: sum(member["here"] for member in group()["members"].values()) == 2)
    input = await robot.create_publisher("/input", STRING, QoS(depth=50))

    def current() -> str:
        return str(group()["current"]).rstrip("0123456789")

    def numbers(name: str) -> list[bytes]:
        return [payload for payload in heard[name].payloads if payload in wanted]

    def reached() -> bool:  # a member may be known to us before it knows us
        input.publish(sample("first"))
        return bool(heard[current()].samples)

    await until(reached)
    first, wanted = current(), [text(str(number)) for number in range(20)]
    for number in range(20):
        input.publish(sample(str(number)))
    await until(lambda: len(numbers(first)) == 20)
    client = await robot.create_client("/add", ADD)
    assert await client.wait_available(30)
    assert total(await client.call(Request(pair(1, 2)))) == 3
    other = "cloud" if first == "edge" else "edge"
    assert (numbers(first), numbers(other)) == (wanted, [])
    at = [gateway.config.gateway.name for gateway in overlay.gateways].index(first)
    await overlay.gateways[at].__aexit__()
    await until(lambda: group()["current"].startswith(other))
    input.publish(sample("after"))
    await until(lambda: text("after") in heard[other].payloads)
    assert text("after") not in heard[first].payloads


@pytest.mark.parametrize(
    ("remote", "path", "words"),
    [
        ({"anycast": {}, "automatic": {"allow": ["/a"]}}, "remotes[0].automatic", "a remote of its own"),
        (
            {"address": ["ws://a", "ws://b"], "anycast": {"members": ["edge*"]}},
            "remotes[0].anycast.members",
            'needs "address": "overlay"',
        ),
    ],
)
def test_mistakes_of_groups(tmp_path: Path, remote: dict[str, Any], path: str, words: str) -> None:
    """What a group of members cannot have is refused with the path of the mistake."""
    bundle = tmp_path / "robot.ropeway"
    write_private(bundle, member("robot").to_text())
    given = {"gateway": {"overlay": {"identity": str(bundle)}}, "remotes": [{"address": "overlay", **remote}]}
    with pytest.raises(ConfigError) as caught:
        config.parse(given)
    assert any(where == path and words in text for where, text in caught.value.problems), caught.value.problems
