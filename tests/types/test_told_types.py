"""ropeway.types.told_types: what peers tell about types."""

from __future__ import annotations

import tracemalloc

import pytest

from ropeway import limits
from ropeway.errors import InvalidDefinition, TypeConflict, UnknownType
from ropeway.types import TypeRegistry
from ropeway.types.told_types import DefinitionTeller


@pytest.fixture
def registry() -> TypeRegistry:
    return TypeRegistry()


def fields(registry: TypeRegistry, name: str) -> list[str]:
    return [f"{field.type.spelled()} {field.name}" for field in registry.definition(name).fields]


def test_forgotten_with_its_teller(registry: TypeRegistry) -> None:
    """A definition that one peer told is known until that peer leaves, and so is what was made of it."""
    teller = DefinitionTeller(registry)
    teller.tell("my/msg/Speed", "float64 v\nmy/Unit unit\n================\nMSG: my/Unit\nstring name\n")
    codec = registry.codec("my/msg/Speed")
    assert codec.decode(codec.encode({"v": 2.0}))["v"] == 2.0
    assert teller.held_bytes > 0
    kept = registry.codec("std_msgs/msg/String")
    teller.leave()
    for name in ("my/msg/Speed", "my/msg/Unit"):
        assert not registry.has(name)
        with pytest.raises(UnknownType):
            registry.codec(name)
    assert registry.codec("std_msgs/msg/String") is kept
    assert not len(registry.told)
    assert teller.held_bytes == 0


def test_told_by_several(registry: TypeRegistry) -> None:
    """A definition that several told stays until the last of them leaves, parts of others included."""
    first, second = DefinitionTeller(registry), DefinitionTeller(registry)
    part = "\n================\nMSG: my/Unit\nstring name\n"
    first.tell("my/msg/Speed", "my/Unit unit" + part)
    second.tell("my/msg/Way", "my/Unit unit" + part)
    first.leave()
    assert not registry.has("my/msg/Speed")
    registry.codec("my/msg/Way")
    second.leave()
    assert not registry.has("my/msg/Unit")


def test_services_are_forgotten(registry: TypeRegistry) -> None:
    """A service and its parts are forgotten as messages are."""
    teller = DefinitionTeller(registry)
    teller.tell("my/srv/Go", "bool a\n---\nbool b\n")
    registry.codec("my/srv/Go_Request")
    assert "my/srv/Go" in registry.names("srv")
    teller.leave()
    assert not registry.has("my/srv/Go")
    assert "my/srv/Go" not in registry.names("srv")


def test_first_client_counts(registry: TypeRegistry) -> None:
    """While a client is connected, another cannot change what it told; once it has left, the other's counts."""
    wrong, right = DefinitionTeller(registry), DefinitionTeller(registry)
    wrong.tell("my/msg/Speed", "string poisoned\n")
    with pytest.raises(TypeConflict):
        right.tell("my/msg/Speed", "float64 v\n")
    wrong.leave()
    right.tell("my/msg/Speed", "float64 v\n")
    assert fields(registry, "my/msg/Speed") == ["float64 v"]


def test_a_graph_knows_better(registry: TypeRegistry) -> None:
    """What a graph tells takes the place of what a client told, and stays when the client leaves."""
    client, graph = DefinitionTeller(registry), DefinitionTeller(registry, graph=True)
    client.tell("my/msg/Speed", "string poisoned\n")
    registry.codec("my/msg/Speed")
    graph.tell("my/msg/Speed", "float64 v\n")
    assert registry.codec("my/msg/Speed").encode({"v": 1.0})[4:] == bytes(6) + b"\xf0\x3f"
    with pytest.raises(TypeConflict):
        client.tell("my/msg/Speed", "string again\n")
    client.leave()
    assert fields(registry, "my/msg/Speed") == ["float64 v"]
    graph.leave()
    assert not registry.has("my/msg/Speed")


def test_built_in_definitions_stay(registry: TypeRegistry) -> None:
    """What the system defines cannot be told otherwise, and is not forgotten with who told the same."""
    teller = DefinitionTeller(registry, graph=True)
    teller.tell("std_msgs/msg/String", "int8 data\n")
    assert fields(registry, "std_msgs/msg/String") == ["string data"]
    with pytest.raises(TypeConflict):
        teller.tell("my/msg/A", "std_msgs/String s\n================\nMSG: std_msgs/String\nint8 data\n")
    assert not registry.has("my/msg/A")
    teller.tell("my/msg/A", "std_msgs/String s\n================\nMSG: std_msgs/String\nstring data\n")
    teller.leave()
    assert registry.has("std_msgs/msg/String")


BOMBS = {
    "texts": "string[16777215] a\n",
    "numbers": "float64[16777215] a\n",
    "truth values": "bool[1000000] a\n",
    "more truth values": "my/B[100] b\n================\nMSG: my/B\nbool[1000] x\nbool[500] y\n",
    "fields": "".join(f"bool a{i}\n" for i in range(20_000)),
    "constants": "".join(f"bool A{i}=true\n" for i in range(20_000)),
    "characters": "# " + "x" * 1_000_000 + "\nbool a\n",
    "empty messages": "std_msgs/Empty[67108864] a\n",
    "products": "my/B[200] b\n" + "".join(
        f"================\nMSG: my/{a}\nmy/{b}[200] x\n" for a, b in ("BC", "CD", "DE")
    ) + "================\nMSG: my/E\nbool[200] x\n",
    "doubles": "my/D0 a\n" + "".join(
        f"================\nMSG: my/D{i}\nmy/D{i + 1} a\nmy/D{i + 1} b\n" for i in range(40)
    ) + "================\nMSG: my/D40\nbool x\n",
    "chain": "my/C0 a\n" + "".join(
        f"================\nMSG: my/C{i}\nmy/C{i + 1} a\n" for i in range(500)
    ) + "================\nMSG: my/C500\nbool x\n",
    "itself": "my/Bomb[5] a\n",
    "nested idl": f"module my {{ module msg {{ struct Bomb {{ {'sequence<' * 5000}boolean{'>' * 5000} a; }}; }}; }};",
    "nested expression": "module my { module msg { const long A = " + "(" * 5000 + "1" + ")" * 5000 + "; }; };",
}  # fmt: skip


@pytest.mark.parametrize("text", BOMBS.values(), ids=BOMBS)
def test_bombs(registry: TypeRegistry, text: str) -> None:
    """A definition that would cost much more than its text is refused before any code is made of it."""
    registry.codec("std_msgs/msg/Empty")
    teller = DefinitionTeller(registry)
    tracemalloc.start()
    try:
        with pytest.raises(InvalidDefinition):
            teller.tell("my/msg/Bomb", text)
            registry.codec("my/msg/Bomb")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 16 << 20
    teller.leave()
    assert not registry.has("my/msg/Bomb")


def test_parts_told_later_count(registry: TypeRegistry) -> None:
    """A type whose part is told later is bounded with that part."""
    teller = DefinitionTeller(registry)
    teller.tell("my/msg/Outer", "my/Inner[100] a\n")
    teller.tell("my/msg/Inner", "string[1000] a\n")
    with pytest.raises(InvalidDefinition, match="texts and messages"):
        registry.codec("my/msg/Outer")


def test_too_many(registry: TypeRegistry) -> None:
    """One peer may tell so many definitions and fields, and not more."""
    teller = DefinitionTeller(registry)
    for i in range(limits.DEFINITIONS_PER_CONNECTION):
        teller.tell(f"my/msg/T{i}", "bool a\n")
    with pytest.raises(InvalidDefinition, match="one too many"):
        teller.tell("my/msg/Next", "bool a\n")
    other = DefinitionTeller(registry)
    many = "".join(f"bool a{i}\n" for i in range(limits.DEFINITION_FIELDS))
    with pytest.raises(InvalidDefinition, match="would be told"):
        for i in range(limits.FIELDS_PER_CONNECTION // limits.DEFINITION_FIELDS + 1):
            other.tell(f"my/msg/L{i}", many)
    assert other.held_bytes <= limits.FIELDS_PER_CONNECTION * 10_000


def test_told_names_are_not_suggested(registry: TypeRegistry) -> None:
    """Who misspells a name is told what the system has, whatever peers told."""
    teller = DefinitionTeller(registry)
    teller.tell("sensor_msgs/msg/Imagf", "bool a\n")
    with pytest.raises(UnknownType, match="did you mean sensor_msgs/msg/Image"):
        registry.codec("sensor_msgs/msg/Imagg")
