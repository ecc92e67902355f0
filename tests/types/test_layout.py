"""Plans: alignment, inlining and limits."""

from __future__ import annotations

import tracemalloc

import pytest

from ropeway.errors import InvalidDefinition
from ropeway.types import TypeRegistry
from ropeway.types.layout import Call, Loop, Numbers, Plan, Planner, Run, Step

from .messages import probe_registry


def plan(text: str, layout: str = "cdr") -> Plan:
    """The plan of a message with this definition."""
    registry = probe_registry()
    registry.add_text("t/msg/T", text)
    return Planner(registry.definition, layout).plan("t/msg/T")


def runs(steps: list[Step]) -> list[tuple[int, int]]:
    """Alignment and size of the runs among ``steps``."""
    return [(step.align, step.size) for step in steps if isinstance(step, Run)]


def test_values_at_known_distances_are_one_run() -> None:
    """Padding between values is computed while planning."""
    assert runs(plan("uint8 a\nfloat64 b\nbool c\nint16 d\n").steps) == [(1, 20)]
    assert runs(plan("uint8 a\nfloat64 b\nbool c\nint16 d\n", "ros1").steps) == [(1, 12)]


def test_alignment_after_text() -> None:
    """After a string nothing is known; a run then grows until it needs a greater alignment."""
    assert runs(plan("string a\nint16 b\nint16 c\nfloat64 d\nuint8 e\n").steps) == [(1, 4), (2, 4), (8, 9)]


def test_alignment_after_sequences() -> None:
    """After a sequence that may be empty only the smaller alignment is known."""
    steps = plan("float64[] a\nint32 b\nfloat64 c\nint32[] d\nint32 e\nfloat32[] f\nint32 g\n").steps
    assert [step.align for step in steps if isinstance(step, Numbers)] == [8, 1, 1]
    assert runs(steps) == [(1, 4), (1, 4), (8, 12), (1, 8), (1, 4)]


def test_alignment_in_loops() -> None:
    """What is known at the start of an element holds for the first and for all later ones."""
    steps = plan("probe/Inner[] a\nuint8 b\n").steps
    loop = next(step for step in steps if isinstance(step, Loop))
    assert runs(loop.steps) == [(1, 1), (8, 12)]
    assert loop.minimum == 13


def test_empty_message() -> None:
    """An empty message is one byte in CDR and nothing in ROS 1."""
    assert plan("").minimum == 1
    assert plan("", "ros1").minimum == 0


def test_long_messages_call() -> None:
    """A message with very many fields, or very deep loops, has parts with plans of their own."""
    assert any(isinstance(step, Call) for step in Planner(probe_registry().definition).plan("probe/msg/Long").steps)
    registry = TypeRegistry()
    registry.add_text("t/msg/N0", "uint8 a\n")
    for number in range(1, 40):
        registry.add_text(f"t/msg/N{number}", f"N{number - 1}[] a\n")
    codec = registry.codec("t/N39")
    value: dict[str, object] = {"a": 7}
    for _ in range(39):
        value = {"a": [value]}
    assert codec.decode(codec.encode(value)) == value
    assert codec.decode(b"\0\0" + codec.encode({})[2:]) == {"a": []}


def test_definitions_that_explode() -> None:
    """A definition that grows by a factor at every level costs no more than its parts."""
    registry = TypeRegistry()
    registry.add_text("t/msg/N0", "string a\n")
    for number in range(1, 12):
        registry.add_text(f"t/msg/N{number}", "".join(f"N{number - 1} a{i}\n" for i in range(5)))
    with pytest.raises(InvalidDefinition, match="its fixed part is above 64 MiB"):
        registry.codec("t/N11")
    assert len(registry.codec("t/N5").encode({})) > 5**5


@pytest.mark.parametrize("text", ["T t\n", "T[] t\n", "Back b\n"])
def test_endless_definitions(text: str) -> None:
    """A message that contains itself is refused."""
    registry = TypeRegistry()
    registry.add_text("t/msg/Back", "T t\n")
    registry.add_text("t/msg/T", text)
    with pytest.raises(InvalidDefinition, match="it contains itself"):
        registry.codec("t/T")
    assert registry.hash("t/T").startswith("RIHS01_")
    with pytest.raises(InvalidDefinition, match="it contains itself"):
        registry.md5("t/T")


def test_deep_definitions() -> None:
    """Messages in messages beyond a depth nobody needs are refused."""
    registry = TypeRegistry()
    registry.add_text("t/msg/N0", "uint8 a\n")
    for number in range(1, 1500):
        registry.add_text(f"t/msg/N{number}", f"N{number - 1} a\n")
    assert len(registry.codec("t/N63").encode({})) == 5
    with pytest.raises(InvalidDefinition, match="more than 64 messages stand one in another"):
        registry.codec("t/N1499")
    assert registry.hash("t/N1499").startswith("RIHS01_")
    assert registry.full_text("t/N1499").count("MSG: ") == 1499


def test_enormous_arrays() -> None:
    """Arrays of fixed size beyond 64 MiB are refused before any of it is allocated."""
    registry = TypeRegistry()
    registry.add_text("t/msg/Row", "float64[100000] a\n")
    registry.add_text("t/msg/Rows", "Row[100000] rows\n")
    registry.codec("t/Row")
    with pytest.raises(InvalidDefinition, match="its fixed part is above 64 MiB"):
        registry.codec("t/Rows")


@pytest.mark.parametrize(
    "text",
    [
        "std_msgs/Empty[60000000] a\n",
        "bool[60000000] a\n",
        "string[16000000] a\n",
        "float64[16000000] a\n",
    ],
    ids=["messages", "truth values", "texts", "numbers"],
)
def test_large_types_of_the_operator(text: str) -> None:
    """A type of the operator's own files whose every message would be enormous is refused, and says what to change."""
    registry = TypeRegistry()
    registry.add_text("t/msg/T", text)
    tracemalloc.start()
    try:
        with pytest.raises(InvalidDefinition, match="make its arrays sequences, or shorter"):
            registry.codec("t/msg/T")
        _, peak = tracemalloc.get_traced_memory()
    finally:
        tracemalloc.stop()
    assert peak < 16 << 20
