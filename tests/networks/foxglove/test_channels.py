"""What there is to see: topics as channels, services, and their definitions."""

from __future__ import annotations

import json

import pytest

from ropeway.errors import TypesError
from ropeway.hub.hub import Hub
from ropeway.networks.foxglove.channels import Catalogue, SchemaWriter
from ropeway.networks.foxglove.settings import FoxgloveSettings, patterns
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from tests.networks.foxglove.viewer import Sight
from tests.support.inbox import Inbox
from tests.support.messages import STRING
from tests.support.services import ADD, add
from tests.support.until import until

INT = "std_msgs/msg/Int32"


async def catalogue_of(sight: Sight, settings: FoxgloveSettings | None = None) -> tuple[Catalogue, list[int]]:
    """Return a table of its own of the network, and the numbers of channels at each change."""
    hub = Hub(await sight.participant("/other"))
    changes: list[int] = []
    writer = SchemaWriter(sight.registry, None)
    found = Catalogue(
        hub.view("test", alone=True),
        writer,
        settings or FoxgloveSettings(),
        lambda: changes.append(len(found.channels)),
    )
    return found, changes


async def test_one_channel_per_type(dark: Sight) -> None:
    """A topic with two types is two channels, which keep their ids while others come and go."""
    await dark.start()
    found, _ = await catalogue_of(dark)
    await dark.robot.create_publisher("/a", STRING)
    assert found.update()
    (first,) = found.channels.values()
    other = await dark.participant("/second")
    publisher = await other.create_publisher("/a", INT)
    assert found.update()
    assert {channel.type for channel in found.channels.values()} == {STRING, INT}
    assert found.channels[first.id] is first
    assert not found.update()
    await publisher.close()
    assert found.update()
    assert list(found.channels.values()) == [first]


async def test_what_others_read(dark: Sight) -> None:
    """A topic that a node only reads is a channel, too, so that viewers can publish it."""
    await dark.start()
    found, _ = await catalogue_of(dark)
    await dark.robot.create_subscription("/cmd", STRING, QoS(), Inbox())
    assert found.update()
    assert [channel.topic for channel in found.channels.values()] == ["/cmd"]


async def test_services(dark: Sight) -> None:
    """A service is told with the definitions of its request and response; one that nobody serves is not."""
    await dark.start()
    found, _ = await catalogue_of(dark, FoxgloveSettings(services=patterns(("/add",))))
    await dark.robot.create_client("/sub", ADD)
    for name in ("/add", "/other"):
        await dark.robot.create_service(name, ADD, add)
    assert found.update()
    (service,) = found.services.values()
    told = json.loads(service.told)
    assert (told["name"], told["type"], service.lacks) == ("/add", ADD, False)
    assert told["request"]["schema"] == told["requestSchema"] == dark.registry.full_text(f"{ADD}_Request")
    assert told["response"]["encoding"] == "cdr"


async def test_told_at_once(dark: Sight) -> None:
    """While it is started, changes are told; once it is stopped, they are not."""
    await dark.start()
    found, changes = await catalogue_of(dark)
    found.start()
    await dark.robot.create_publisher("/a", STRING)
    await until(lambda: changes and changes[-1] == 1)
    await found.stop()
    before = len(changes)
    await dark.robot.create_publisher("/b", STRING)
    assert (len(changes), len(found.channels)) == (before, 1)
    found.start()
    assert len(found.channels) == 2
    await found.stop()


async def test_definitions_that_are_told_later(dark: Sight) -> None:
    """A channel without a definition is another one once the definition is known, and is told."""
    await dark.start()
    dark.registry = TypeRegistry()
    found, changes = await catalogue_of(dark)
    await dark.robot.create_publisher("/a", "late_msgs/msg/Late")
    found.update()
    (lacking,) = found.channels.values()
    assert (lacking.lacks, json.loads(lacking.told)["schema"]) == (True, "")
    found.look_for_types()
    assert changes == []
    dark.registry.add_text("late_msgs/msg/Late", "int32 x\n")
    found.look_for_types()
    (known,) = found.channels.values()
    assert changes == [1]
    assert (known.lacks, known.id != lacking.id) == (False, True)
    await found.stop()


def test_types_that_nobody_knows() -> None:
    """A type that is not known has no schema, and no codec."""
    writer = SchemaWriter(TypeRegistry(), None)
    assert writer.schema("no_msgs/msg/No") is None
    assert writer.name(STRING) == STRING
    with pytest.raises(TypesError):
        writer.codec("no_msgs/msg/No")
