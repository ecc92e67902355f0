"""rosapi's TypeDef."""

from __future__ import annotations

from ropeway.types import TypeRegistry
from ropeway.types.typedef import full_text_of


def test_of_a_message() -> None:
    """A message and all below it are described with names of two parts and IDL's names of primitives."""
    registry = TypeRegistry()
    registry.add_text("p/msg/A", "float64[3] a\nbool b true\nbyte c\nstd_msgs/Header[] d\nstring e\nint8 ONE=1\n")
    found = registry.typedefs("p/A")
    assert [typedef["type"] for typedef in found] == ["p/A", "std_msgs/Header", "builtin_interfaces/Time"]
    assert found[0] == {
        "type": "p/A",
        "fieldnames": ["a", "b", "c", "d", "e"],
        "fieldtypes": ["double", "boolean", "octet", "std_msgs/Header", "string"],
        "fieldarraylen": [3, -1, -1, 0, -1],
        "examples": ["[]", "True", "b'\\x00'", "[]", ""],
        "constnames": ["ONE"],
        "constvalues": ["1"],
    }


def test_of_a_request() -> None:
    """A part of a service is described under its own name."""
    assert TypeRegistry().typedefs("std_srvs/srv/SetBool_Request")[0]["type"] == "std_srvs/SetBool_Request"


def test_there_and_back() -> None:
    """A definition that is read from its description has the same layout, with no constants and no bounds."""
    registry = TypeRegistry()
    registry.add_text("p/msg/A", "float64[3] a\nbool b true\nbyte c\nstd_msgs/Header[] d\nstring<=5[] e\nint8 ONE=1\n")
    registry.add_text("p/srv/S", "A a\n---\nA[2] a\n")
    for name in ("p/msg/A", "p/srv/S"):
        other = TypeRegistry()
        parts = [registry.typedefs(root) for root in registry.roots(name)]
        other.add_full_text(name, full_text_of(name, parts))
        for root in registry.roots(name):
            assert other.definition(root).same_layout(registry.definition(root))
    assert not other.definition("p/msg/A").constants
