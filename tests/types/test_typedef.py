"""rosapi's TypeDef."""

from __future__ import annotations

from ropeway.types import TypeRegistry


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
