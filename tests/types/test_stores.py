"""The messages of the distributions."""

from __future__ import annotations

import subprocess
import sys

import pytest
from rosbags.typesys import get_typestore

from ropeway.types.definition import Definition
from ropeway.types.parser import parse_msg
from ropeway.types.stores import DISTROS, store_table
from tests.types.standard import FILE, STORES, from_rosbags, written


def test_file_is_up_to_date() -> None:
    """The file holds what rosbags knows of every distribution; `python -m tests.types.standard` writes it anew."""
    assert FILE.read_text("utf-8") == written()


@pytest.mark.parametrize("distro", DISTROS)
def test_same_definitions(distro: str) -> None:
    """Every definition has the fields, default values and constants that the distribution gives it."""

    def parts(definition: Definition) -> object:
        return definition.fields, definition.constants

    known = from_rosbags(get_typestore(STORES[distro]).fielddefs)
    table = store_table(distro)
    assert table.keys() == known.keys()
    for name, text in table.items():
        assert parts(parse_msg(name, text)) == parts(known[name])


def test_unknown_distro() -> None:
    """An unknown distribution is refused with those that are known."""
    with pytest.raises(ValueError, match=r"'melodic' is not a known ROS distribution; known are noetic, foxy"):
        store_table("melodic")


@pytest.mark.parametrize("distro", DISTROS)
def test_default_values(distro: str) -> None:
    """A quaternion is a rotation unless told otherwise, in every distribution."""
    name = "geometry_msgs/msg/Quaternion"
    assert [field.default for field in parse_msg(name, store_table(distro)[name]).fields] == [0.0, 0.0, 0.0, 1.0]


def test_a_registry_costs_little() -> None:
    """A registry and the codec of Image need neither numpy nor rosbags."""
    code = (
        "import sys; from ropeway.types import TypeRegistry; c = TypeRegistry().codec('sensor_msgs/msg/Image');"
        "c.json(c.encode({})); print([m for m in ('numpy', 'rosbags') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
