"""Messages in the layouts of other distributions."""

from __future__ import annotations

import json
import logging
import random

import pytest

from ropeway.errors import DecodeError
from ropeway.types import TypeRegistry
from ropeway.types.distros import CHANGED
from ropeway.types.stores import DISTROS, store_table
from ropeway.types.told_types import DefinitionTeller

from .messages import random_message

ROS2 = [distro for distro in DISTROS if distro != "noetic"]
HERE = TypeRegistry()


def test_changed_types_are_all() -> None:
    """The list of types that have changed is what the stores of the distributions tell."""
    changed = set()
    for distro in ROS2:
        there = TypeRegistry(distro, alone=True)
        changed |= {
            name
            for name in store_table(distro)
            if HERE.has(name) and not HERE.definition(name).same_layout(there.definition(name))
        }
    assert changed - {"rmw_dds_common/msg/Gid"} == CHANGED


@pytest.mark.parametrize(
    ("name", "distro"), [(name, distro) for name in sorted(CHANGED) for distro in ROS2 if name in store_table(distro)]
)
def test_messages_of_other_distributions_are_understood(name: str, distro: str) -> None:
    """A message of any distribution is read, however it is read, with all fields that both have."""
    there = TypeRegistry(distro, alone=True)
    for seed in range(5):
        message = random_message(there, name, random.Random(seed), finite=True)
        raw = there.codec(name).encode(message)
        codec = HERE.codec(name)
        fitting = codec.fitting(raw)
        assert codec.fitting(fitting) == fitting
        here = codec.decode(raw)
        common = here.keys() & message.keys()
        assert common
        assert json.loads(codec.json(raw)) == json.loads(codec.json(fitting))
        for field in common:
            if not isinstance(message[field], dict):
                assert str(here[field]) == str(message[field])


def test_what_is_missing_is_told_once(caplog: pytest.LogCaptureFixture) -> None:
    """Fields that the other distribution lacks are filled and told once, those that only it has are left out."""
    registry, humble = TypeRegistry(), TypeRegistry("humble", alone=True)
    raw = humble.codec("sensor_msgs/Range").encode({"range": 1.25})
    with caplog.at_level(logging.WARNING):
        for _ in range(3):
            assert registry.codec("sensor_msgs/Range").decode(raw)["variance"] == 0
    assert caplog.messages == ["sensor_msgs/msg/Range.variance is missing in Humble, filled with 0"]
    caplog.clear()
    assert registry.others is not None
    convert = registry.others.variant("humble").outward("sensor_msgs/msg/Range")
    assert convert is not None
    for _ in range(3):
        theirs = convert(registry.codec("sensor_msgs/Range").encode({"range": 1.25}))
    assert humble.codec("sensor_msgs/Range").decode(theirs)["range"] == 1.25
    assert caplog.messages == ["sensor_msgs/msg/Range.variance is not known in Humble and left out"]
    assert registry.others.variant("jazzy").outward("sensor_msgs/msg/Range") is None
    assert registry.others.variant("humble").outward("std_msgs/msg/String") is None


def test_a_hash_tells_whose_definition_it_is() -> None:
    """The hash of a type tells ours from a distribution's, also of types that are made of one that has changed."""
    registry = TypeRegistry()
    registry.add_text("my_msgs/msg/Scan", "sensor_msgs/Range[] ranges\n")
    others = registry.others
    assert others is not None
    for name in ("sensor_msgs/msg/Range", "my_msgs/msg/Scan"):
        assert others.by_hash(name, registry.hash(name)) is registry
        assert others.by_hash(name, others.variant("humble").hash(name)) is not registry
        assert others.by_hash(name, "RIHS01_nobody's") is None


def test_definitions_of_a_sourced_humble_are_a_distributions() -> None:
    """Where our own definition is that of another distribution, messages of the others are understood all the same."""
    registry, kilted = TypeRegistry(), TypeRegistry("kilted", alone=True)
    registry.add_text(
        "sensor_msgs/msg/Range", TypeRegistry("humble", alone=True).text("sensor_msgs/Range"), replace=True
    )
    others = registry.others
    assert others is not None
    assert others.touches("sensor_msgs/msg/Range")
    convert = others.variant("kilted").outward("sensor_msgs/msg/Range")
    assert convert is not None
    theirs = convert(registry.codec("sensor_msgs/Range").encode({"range": 1.25}))
    assert theirs == kilted.codec("sensor_msgs/Range").encode({"range": 1.25})


def test_what_peers_tell_with_types_of_their_distribution() -> None:
    """A peer of another distribution may tell a type of its own with the standard types as it has them."""
    registry, humble = TypeRegistry(), TypeRegistry("humble", alone=True)
    humble.add_text("my_msgs/msg/Scan", "sensor_msgs/Range[] ranges\n")
    DefinitionTeller(registry, graph=True).tell("my_msgs/msg/Scan", humble.full_text("my_msgs/msg/Scan"))
    assert registry.hash("my_msgs/msg/Scan") != humble.hash("my_msgs/msg/Scan")
    raw = humble.codec("my_msgs/msg/Scan").encode({"ranges": [{"range": 1.25}]})
    assert registry.codec("my_msgs/msg/Scan").decode(raw)["ranges"][0]["range"] == 1.25


def test_types_within_types() -> None:
    """A type that is made of one that has changed is carried over, too."""
    registry, foxy = TypeRegistry(), TypeRegistry("foxy", alone=True)
    raw = foxy.codec("visualization_msgs/MarkerArray").encode({"markers": [{"id": 3}, {"id": 4}]})
    found = registry.codec("visualization_msgs/MarkerArray").decode(raw)
    assert [marker["id"] for marker in found["markers"]] == [3, 4]


def test_own_definitions_are_taken_at_their_word() -> None:
    """A type that the user defines, or a damaged message, is not taken for another distribution's."""
    registry = TypeRegistry()
    registry.add_text("sensor_msgs/msg/Range", "float64 distance\n", replace=True)
    raw = TypeRegistry("humble").codec("sensor_msgs/Range").encode({"range": 1.25})
    with pytest.raises(DecodeError):
        registry.codec("sensor_msgs/Range").decode(raw)
    with pytest.raises(DecodeError):
        HERE.codec("sensor_msgs/Range").decode(raw[:-8])
