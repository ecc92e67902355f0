"""The tables of rosbags, read without its dataclasses."""

from __future__ import annotations

import subprocess
import sys

import pytest
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_typestore

from ropeway.errors import InvalidDefinition
from ropeway.types.stores import DISTROS, from_rosbags, store_table


@pytest.mark.parametrize("distro", DISTROS)
def test_same_tables(distro: str) -> None:
    """A table is what a plain import of rosbags gives."""
    assert store_table(distro) == get_typestore(Stores(DISTROS[distro])).fielddefs


def test_unknown_distro() -> None:
    """An unknown distribution is refused with those that are known."""
    with pytest.raises(ValueError, match=r"'melodic' is not a known ROS distribution; known are noetic, foxy"):
        store_table("melodic")


def test_defaults_are_added() -> None:
    """Default values that the tables lack are put in."""
    name = "geometry_msgs/msg/Quaternion"
    assert [f.default for f in from_rosbags(name, store_table("jazzy")[name]).fields] == [0.0, 0.0, 0.0, 1.0]


def test_unsupported_primitive() -> None:
    """A primitive type that no .msg has is refused by name."""
    with pytest.raises(InvalidDefinition, match="fields of type float128 are not supported"):
        found = get_types_from_idl("module p { module msg { struct A { long double x; }; }; };")
        from_rosbags("p/msg/A", found["p/msg/A"])
    assert issubclass(TypesysError, Exception)


def test_a_registry_costs_little() -> None:
    """A registry and the codec of Image need neither numpy nor the parsers of rosbags."""
    code = (
        "import sys; from ropeway.types import TypeRegistry; c = TypeRegistry().codec('sensor_msgs/msg/Image');"
        "c.json(c.encode({})); print([m for m in ('numpy', 'rosbags.typesys') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
