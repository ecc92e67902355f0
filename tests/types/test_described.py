"""ropeway.types.described: the definitions that nodes tell, and that we tell."""

from __future__ import annotations

from copy import deepcopy
from typing import Any

import pytest

from ropeway.errors import InvalidDefinition
from ropeway.types import TypeRegistry
from ropeway.types.described import DESCRIPTION_TYPE, description_of, full_text_of
from ropeway.types.told_types import DefinitionTeller

OWN = """\
# How far the arm is.
uint8 IDLE=0
uint8 state 0
string<=10 label "none"
float64[3] at
int32[<=4] few
Part[] parts
geometry_msgs/Point goal
"""
PART = "byte raw\nwstring name\nbool[2] on\n"


def owner() -> TypeRegistry:
    found = TypeRegistry()
    found.add_text("my_msgs/msg/Part", PART)
    found.add_text("my_msgs/msg/Arm", OWN)
    found.add_text("my_msgs/msg/Nothing", "")
    found.add_text("my_msgs/srv/Grasp", "uint8 HARD=1\nPart part\n---\nbool done\n")
    found.add_text("my_msgs/action/Move", "Part[] parts\n---\nArm arm\n---\nfloat32 left\n")
    return found


NAMES = (
    "my_msgs/msg/Arm",
    "my_msgs/msg/Nothing",
    "my_msgs/srv/Grasp",
    "my_msgs/srv/Grasp_Request",
    "my_msgs/action/Move",
    "my_msgs/action/Move_FeedbackMessage",
    "sensor_msgs/msg/PointCloud2",
)


def learned(name: str, answer: dict[str, Any], hash: str = "") -> TypeRegistry:
    """A registry that knows what an answer tells of a type, after it went over the network."""
    codec = TypeRegistry().codec(f"{DESCRIPTION_TYPE}_Response")
    found = TypeRegistry()
    DefinitionTeller(found, graph=True).tell(name, full_text_of(name, codec.decode(codec.encode(answer)), hash))
    return found


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("sources", [True, False])
def test_there_and_back(name: str, sources: bool) -> None:
    """A type that is described and told to somebody else has the same hash there, with and without its files."""
    ours = owner()
    theirs = learned(name, description_of(ours, name, sources=sources), ours.hash(name))
    if "FeedbackMessage" not in name:
        assert theirs.hash(name) == ours.hash(name)


def test_constants_come_with_the_files() -> None:
    """Constants, defaults and comments are taken from the files that come along."""
    theirs = learned("my_msgs/msg/Arm", description_of(owner(), "my_msgs/msg/Arm"))
    assert theirs.text("my_msgs/msg/Arm") == OWN
    assert theirs.definition("my_msgs/msg/Arm").constants[0].value == 0


def test_files_that_say_something_else() -> None:
    """A file whose fields are not those that are described counts for nothing."""
    answer = description_of(owner(), "my_msgs/msg/Part")
    for text in ("byte raw\n", "not a definition at all {", "byte raw\nwstring name\nbool[3] on\n"):
        answer["type_sources"] = [{"type_name": "my_msgs/msg/Part", "encoding": "msg", "raw_file_contents": text}]
        assert learned("my_msgs/msg/Part", answer).hash("my_msgs/msg/Part") == owner().hash("my_msgs/msg/Part")


def test_another_hash() -> None:
    """What has another hash than what was asked for is refused."""
    with pytest.raises(InvalidDefinition, match="another hash"):
        learned("my_msgs/msg/Part", description_of(owner(), "my_msgs/msg/Part"), owner().hash("my_msgs/msg/Arm"))


def test_a_refusal() -> None:
    """The reason of a node that does not tell is passed on."""
    answer = {"successful": False, "failure_reason": "it is a secret"}
    with pytest.raises(InvalidDefinition, match="it is a secret"):
        learned("my_msgs/msg/Part", answer)


@pytest.mark.parametrize("type_id", [0, 13, 14, 19, 23, 48, 68, 192, 255])
def test_types_that_no_message_has(type_id: int) -> None:
    """A field of a type that no definition can name is refused, not guessed."""
    answer = deepcopy(description_of(owner(), "my_msgs/msg/Part"))
    answer["type_description"]["type_description"]["fields"][0]["type"]["type_id"] = type_id
    with pytest.raises(InvalidDefinition):
        learned("my_msgs/msg/Part", answer)


@pytest.mark.parametrize("field", ["a b", "x\nint32 y", "", "1x"])
def test_names_that_no_field_has(field: str) -> None:
    """A name that cannot stand in a definition does not smuggle another field in."""
    answer = deepcopy(description_of(owner(), "my_msgs/msg/Part", sources=False))
    answer["type_description"]["type_description"]["fields"][0]["name"] = field
    with pytest.raises(InvalidDefinition):
        learned("my_msgs/msg/Part", answer)


def test_missing_parts() -> None:
    """A description that lacks a type that it needs is refused."""
    answer = description_of(owner(), "my_msgs/msg/Arm", sources=False)
    answer["type_description"]["referenced_type_descriptions"] = []
    with pytest.raises(InvalidDefinition):
        learned("my_msgs/msg/Arm", answer)


def test_too_many_fields() -> None:
    """A description with more fields than a definition may have is refused before anything is made of it."""
    answer = description_of(owner(), "my_msgs/msg/Part", sources=False)
    fields = answer["type_description"]["type_description"]["fields"]
    answer["type_description"]["type_description"]["fields"] = fields * 3000
    with pytest.raises(InvalidDefinition, match="more than"):
        learned("my_msgs/msg/Part", answer)
