"""Plans: in which steps the bytes of a message are read or written.

A message is flattened into *runs* of values whose distances are known (one ``struct`` call each) and steps whose
size the message itself tells: strings, sequences, loops over messages. What is known of the alignment is followed
through all of them, so padding is computed while planning wherever it can be. ``reader`` and ``writer`` turn plans
into functions.

Two layouts: ``cdr`` (XCDR1 as ROS 2 sends it: values aligned to their size, strings end with NUL, an empty message
has one dummy byte) and ``ros1`` (no alignment, no NUL, a header begins with ``seq``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Final

from ropeway.errors import InvalidDefinition
from ropeway.limits import DEFINITION_NESTING, FIXED_PART_BYTES
from ropeway.types.definition import HEADER, PRIMITIVES, Definition, Field, FieldType

__all__ = ["CODES", "Call", "Leaf", "Loop", "Numbers", "Plan", "Planner", "Run", "Slot", "Step", "Struct", "Text"]

CODES: Final = {
    "bool": "?",
    "byte": "B",
    "char": "B",
    "int8": "b",
    "uint8": "B",
    "int16": "h",
    "uint16": "H",
    "int32": "i",
    "uint32": "I",
    "int64": "q",
    "uint64": "Q",
    "float32": "f",
    "float64": "d",
}
"""Codes of ``struct`` (and of ``array``, but for bool) for the primitive types of fixed size."""

_INLINE_LEAVES: Final = 256
_INLINE_LOOPS: Final = 4
_OBJECT_BYTES: Final = 64  # of a text, a truth value in an array or a message, once they are read


@dataclass(slots=True, eq=False)
class Leaf:
    """A value of the message that is not a message: a primitive, an array, a sequence."""

    index: int
    type: FieldType
    default: object = None


@dataclass(slots=True, eq=False)
class Struct:
    """A message as its fields, in order."""

    type: str
    fields: list[tuple[str, Struct | Leaf]]


@dataclass(slots=True, eq=False)
class Slot:
    """A part of a run. ``use`` is ``value`` (``count`` numbers of ``leaf``), ``length`` (how long ``leaf`` is) or
    ``pad`` (``count`` zero bytes).
    """

    use: str
    code: str
    count: int
    offset: int
    leaf: Leaf | None = None


@dataclass(slots=True, eq=False)
class Run:
    """Slots at known distances; the position of the first is aligned to ``align`` before."""

    align: int
    slots: list[Slot] = field(default_factory=list)
    size: int = 0


@dataclass(slots=True, eq=False)
class Text:
    """The bytes of a string whose length a run has given."""

    leaf: Leaf


@dataclass(slots=True, eq=False)
class Numbers:
    """The elements of a sequence of primitives whose length a run has given, aligned to ``align`` if there are any."""

    leaf: Leaf
    align: int


@dataclass(slots=True, eq=False)
class Loop:
    """An array or sequence of messages or strings: ``body`` is one element. ``minimum``: its least size in bytes."""

    leaf: Leaf
    node: Struct | Leaf
    steps: list[Step]
    minimum: int
    objects: int


@dataclass(slots=True, eq=False)
class Call:
    """A message that has a plan of its own, because this one is long enough."""

    leaf: Leaf
    plan: Plan


Step = Run | Text | Numbers | Loop | Call


@dataclass(slots=True, eq=False)
class Plan:
    """Lists all steps of one message.

    ``minimum`` is the least number of bytes that it needs, ``objects`` the least number of texts, truth values
    in arrays and messages in it.
    """

    type: str
    node: Struct
    steps: list[Step]
    minimum: int
    objects: int
    layout: str


class Planner:
    """Makes the plans of one message type and of those it calls.

    ``definition`` gives the definition of a name; it is called as ``definition(name, needed_by=parent)``.
    """

    def __init__(self, definition: Callable[..., Definition], layout: str = "cdr") -> None:
        self.definition = definition
        self.layout = layout
        self.plans: dict[str, Plan] = {}
        self._above: list[str] = []

    def plan(self, name: str, *, aligned: bool = True) -> Plan:
        """Return the plan of ``name``; ``aligned`` says that it begins at a multiple of 8.

        Raises ``UnknownType``, ``InvalidDefinition`` where a message contains itself or is beyond all size.
        """
        key = f"{name} {aligned}"
        if key not in self.plans:
            draft = _Draft(self, 8 if aligned else 1)
            node = draft.message(name, self._above[-1] if self._above else "")
            draft.close()
            self.plans[key] = Plan(name, node, draft.steps, draft.minimum, draft.objects, self.layout)
        return self.plans[key]

    def enter(self, name: str, parent: str) -> Definition:
        """Return the definition of ``name`` and mark it as being planned until ``leave``."""
        if name in self._above:
            raise InvalidDefinition(name, "it contains itself")
        if len(self._above) >= DEFINITION_NESTING:
            raise InvalidDefinition(self._above[0], f"more than {DEFINITION_NESTING} messages stand one in another")
        found = self.definition(name, needed_by=parent)
        self._above.append(name)
        return found

    def leave(self) -> None:
        """Unmark the message that was entered last."""
        self._above.pop()


class _Draft:
    """A plan under construction. Positions are known to be ``self.rest`` modulo ``self.step``."""

    def __init__(self, planner: Planner, step: int) -> None:
        self.planner = planner
        self.cdr = planner.layout == "cdr"
        self.steps: list[Step] = []
        self.run: Run | None = None
        self.step, self.rest = step, 0
        self.minimum = self.objects = 0
        self.leaves = 0
        self.loops = 0

    def message(self, name: str, parent: str) -> Struct:
        """Add all fields of a message."""
        definition = self.planner.enter(name, parent)
        self._count(1)
        fields = definition.wire_fields
        if name == HEADER and not self.cdr:
            self.add("pad", "x", 4, 1)
        if not fields and self.cdr:
            self.add("pad", "x", 1, 1)
        struct = Struct(name, [(each.name, self.field(each, name)) for each in fields])
        self.planner.leave()
        return struct

    def field(self, declared: Field, parent: str) -> Struct | Leaf:
        """Add one field."""
        type = declared.type
        if type.is_message and type.kind == "scalar" and self.leaves < _INLINE_LEAVES:
            return self.message(type.base, parent)
        leaf = self.leaf(type, declared.default)
        size = PRIMITIVES.get(type.base, 0)
        if type.kind == "sequence":
            self.add("length", "I", 1, 4, leaf)
        if type.kind == "scalar" and type.is_message:
            self.call(leaf)
        elif type.is_message or (type.kind != "scalar" and not size):
            self.loop(leaf, parent)
        elif type.kind == "sequence":
            self.numbers(leaf, size)
        elif size:
            self.add("value", CODES[type.base], type.size if type.kind == "array" else 1, size, leaf)
        else:
            self.text(leaf)
        return leaf

    def leaf(self, type: FieldType, default: object = None) -> Leaf:
        """Make a new leaf."""
        self.leaves += 1
        return Leaf(self.leaves, type, default)

    def add(self, use: str, code: str, count: int, size: int, leaf: Leaf | None = None) -> None:
        """Add a slot of ``count`` values of ``size`` bytes to the run."""
        need = size if self.cdr else 1
        if need > self.step:
            self.close()
            self.run = Run(need)
            self.step, self.rest = need, 0
        elif self.run is None:
            self.run = Run(1)
        assert self.run is not None
        gap = -self.rest % need
        if gap:
            self.run.slots.append(Slot("pad", "x", gap, self.run.size))
        self.run.slots.append(Slot(use, code, count, self.run.size + gap, leaf))
        self.run.size += gap + size * count
        self.rest = (self.rest + gap + size * count) % self.step
        self._grow(size * count)
        if code == "?" and count > 1:  # which are lists everywhere
            self._count(count)

    def close(self) -> None:
        """End the run that is open."""
        if self.run is not None:
            self.steps.append(self.run)
            self.run = None

    def text(self, leaf: Leaf) -> None:
        """Add a string."""
        self.add("length", "I", 1, 4, leaf)
        self.close()
        self._count(1)
        self.steps.append(Text(leaf))
        if leaf.type.base == "string" or not self.cdr:
            self.step, self.rest = 1, 0
        else:
            self.step, self.rest = min(self.step, 4), self.rest % min(self.step, 4)

    def numbers(self, leaf: Leaf, size: int) -> None:
        """Add the elements of a sequence of primitives."""
        self.close()
        align = size if self.cdr else 1
        self.steps.append(Numbers(leaf, 1 if align <= self.step and self.rest % align == 0 else align))
        self._meet(align, 0)

    def loop(self, leaf: Leaf, parent: str) -> None:
        """Add an array or sequence of messages or strings."""
        self.close()
        outer, before, objects = self.steps, self.minimum, self.objects
        self.loops += 1
        inner = FieldType(leaf.type.base, leaf.type.bound)
        leaves = self.leaves
        while True:
            entry = (self.step, self.rest)
            self.steps, self.minimum, self.objects, self.leaves = [], 0, 0, leaves
            if not inner.is_message:
                node: Struct | Leaf = self.leaf(inner)
                self.text(node)  # type: ignore[arg-type]
            elif self.loops > _INLINE_LOOPS or self.leaves > _INLINE_LEAVES:
                node = self.leaf(inner)
                self.call(node)
            else:
                node = self.message(inner.base, parent)
            self.close()
            self._meet(*entry)
            if (self.step, self.rest) == entry:
                break
        self.loops -= 1
        found = Loop(leaf, node, self.steps, self.minimum, self.objects)
        self.steps, self.minimum, self.objects = outer, before, objects
        self.steps.append(found)
        if leaf.type.kind == "array":
            self._grow(found.minimum * leaf.type.size)
            self._count(found.objects * leaf.type.size)

    def call(self, leaf: Leaf) -> None:
        """Add a message by a plan of its own."""
        self.close()
        plan = self.planner.plan(leaf.type.base, aligned=False)
        self.steps.append(Call(leaf, plan))
        self._grow(plan.minimum)
        self._count(plan.objects)
        self.step, self.rest = 1, 0

    def _meet(self, step: int, rest: int) -> None:
        """Keep only what is known of the position both here and at ``rest`` modulo ``step``."""
        common = min(step, self.step)
        while (rest - self.rest) % common:
            common //= 2
        self.step, self.rest = common, rest % common

    def _grow(self, size: int) -> None:
        self.minimum += size
        self._count(0)

    def _count(self, objects: int) -> None:
        self.objects += objects
        if self.minimum + _OBJECT_BYTES * self.objects > FIXED_PART_BYTES:
            why = f"its fixed part is above {FIXED_PART_BYTES >> 20} MiB; make its arrays sequences, or shorter"
            raise InvalidDefinition(self.planner._above[0], why)
