"""Definitions of messages, services and actions, as files, recordings and peers tell them."""

from __future__ import annotations

from typing import Final

from fuzz.target import Target
from ropeway.errors import TypesError
from ropeway.types import TypeRegistry
from ropeway.types.idl import parse_idl
from ropeway.types.told_types import DefinitionTeller

__all__ = ["TARGETS"]

_MEMORY_BYTES: Final = 256 << 20  # an empty message with the largest fixed array of truths: bytes, lists, a JSON text

_MSG: Final = """\
# a comment
int32 A=-7
string B = "x # y"
uint8[3] a [1, 2, 3]
string<=5[<=3] b
std_msgs/Header header
Inner[] c
wstring d 'w'
float64 e 1.5e3
================================================================================
MSG: fuzz/Inner
time stamp
Other[2] o
===
MSG: fuzz/Other
bool x true
"""
_IDL: Final = """\
module fuzz { module msg {
  module Main_Constants { const int32 A = 7; };
  @verbatim (language="comment", text="x")
  struct Main {
    @default (value=3) long a;
    sequence<string<5>, 3> b;
    double c[3];
    builtin_interfaces::msg::Time stamp;
  };
}; };
"""


def _definition(data: bytes) -> None:
    """A text that a peer tells of a type is refused, or gives a codec that reads what it writes."""
    registry = TypeRegistry()
    DefinitionTeller(registry).tell("fuzz/msg/Main", data.decode(errors="replace"))
    _use(registry, "fuzz/msg/Main")


def _use(registry: TypeRegistry, name: str) -> None:
    codec = registry.codec(name)
    payload = codec.encode({})
    codec.decode(payload)
    codec.json(payload)
    registry.hash(name)
    registry.md5(name)
    registry.typedefs(name)
    registry.full_text(name)


def _interface(data: bytes) -> None:
    """A service or an action."""
    kind, parts = (
        ("srv", ("_Request", "_Response")) if data[:1] < b"\x80" else ("action", ("_Goal", "_SendGoal_Request"))
    )
    registry = TypeRegistry()
    DefinitionTeller(registry).tell(f"fuzz/{kind}/Main", data[1:].decode(errors="replace"))
    registry.hash(f"fuzz/{kind}/Main")
    for part in parts:
        _use(registry, f"fuzz/{kind}/Main{part}")


def _idl(data: bytes) -> None:
    parse_idl("fuzz/msg/Main", data.decode(errors="replace"))


TARGETS: Final = {
    "definitions": Target(
        _definition,
        (TypesError,),
        lambda: [_MSG.encode(), b"string data\n", b"uint8[1000] a\nMain[] b\n"],
        (
            b"[<=",
            b"[]",
            b"=",
            b"MSG: fuzz/",
            b"\n===\n",
            b"---\n",
            b"[99999]",
            b"[9999999]",
            b"string<=",
            b"Header",
            b"int64 ",
        ),
        memory_bytes=_MEMORY_BYTES,
    ),
    "interfaces": Target(
        _interface,
        (TypesError,),
        lambda: [b"\0int64 a\n---\nint64 b\n", b"\x80int32 a\n---\n---\nint32[] b\n"],
        (b"\n---\n",),
        memory_bytes=_MEMORY_BYTES,
    ),
    "idl": Target(
        _idl,
        (TypesError,),
        lambda: [_IDL.encode()],
        (
            b"module ",
            b"struct ",
            b"sequence<",
            b"typedef ",
            b"const ",
            b"@default (value=",
            b"::",
            b"enum ",
            b"#include <",
        ),
        cpu_s=3.0,  # the parser of rosbags is slow, and it is the user's own files that it reads
    ),
}
