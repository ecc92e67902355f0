"""Makes the functions that read messages: from bytes to the objects that an encoding wants.

A reader is Python source generated from a plan, one function per message type and flavour. The flavours differ only
in what they make of arrays:

==========  =========================  ===========================  ==================
flavour     uint8[], char[]            other numbers                fixed arrays
==========  =========================  ===========================  ==================
``object``  bytes                      numpy (little-endian view)   as sequences
``json``    base64 (bounded: numbers)  what orjson writes           as sequences
``cbor``    bytes (bounded: numbers)   tag of RFC 8746 (likewise)   list of numbers
``rosgw``   bytes                      bytes                        bytes
==========  =========================  ===========================  ==================

``json64`` is ``json`` with texts for integers of 64 bits, which JavaScript would round.

Octets (``byte[]``) are bytes in ``object``, ``cbor`` and ``rosgw``, numbers in ``json``; bools are lists everywhere.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Callable
from typing import Any, Final, NamedTuple

import cbor2

from ropeway.types import cbor, values
from ropeway.types.definition import PRIMITIVES
from ropeway.types.layout import CODES, Call, Leaf, Loop, Numbers, Plan, Run, Slot, Step, Struct, Text

__all__ = ["FLAVOURS", "Reader", "make_reader"]

FLAVOURS: Final = ("object", "json", "cbor", "rosgw", "json64")
_TUPLE_LIMIT: Final = 64
_EMPTY_LIMIT: Final = 65536  # elements of no size at all (ROS 1's empty messages) in one message
_TAGS: Final = {
    "uint16": 69,
    "uint32": 70,
    "uint64": 71,
    "int8": 72,
    "int16": 77,
    "int32": 78,
    "int64": 79,
    "float32": 85,
    "float64": 86,
}

Reader = Callable[[bytes, int, int], tuple[Any, int]]
"""``(raw, start, end) -> (value, next)``; raises ``values.Short``, ``struct.error``, ``ValueError``."""


class _Target(NamedTuple):
    """A variable that a run is unpacked into: one number, or a list of ``length`` where that is not 0."""

    name: str
    code: str
    length: int = 0


def make_reader(plan: Plan, flavour: str) -> Reader:
    """Make the function that reads messages of this plan. ``start`` is 4 for CDR (behind its header), 0 for ROS 1."""
    empties = values.Empties(_EMPTY_LIMIT)
    read = _Source(plan.layout, flavour, {}, empties).function(plan)
    if not empties.wanted:
        return read

    def read_anew(raw: bytes, start: int, end: int) -> tuple[Any, int]:
        empties.begin()
        return read(raw, start, end)

    return read_anew


class _Source:
    def __init__(self, layout: str, flavour: str, made: dict[int, Reader], empties: values.Empties) -> None:
        self.cdr = layout == "cdr"
        self.layout, self.made, self.empties = layout, made, empties
        self.texts = flavour == "json64"
        self.flavour = "json" if self.texts else flavour
        self.lines: list[str] = []
        self.scope: dict[str, Any] = {"Short": values.Short}
        self.indent = 1
        self.runs = 0

    def function(self, plan: Plan) -> Reader:
        self.steps(plan.steps)
        source = "\n".join(["def read(raw, p, end):", *self.lines, f" return {self.expression(plan.node)}, p"])
        exec(compile(source, f"<reader of {plan.type}, {self.flavour}>", "exec"), self.scope)  # noqa: S102
        made: Reader = self.scope["read"]
        return made

    def inner(self) -> _Source:
        return _Source(self.layout, "json64" if self.texts else self.flavour, self.made, self.empties)

    def line(self, text: str) -> None:
        self.lines.append(" " * self.indent + text)

    def constant(self, name: str, value: object) -> str:
        self.scope[name] = value
        return name

    def expression(self, node: Struct | Leaf) -> str:
        if isinstance(node, Leaf):
            name = f"v{node.index}"
            if self.texts and node.type.base in ("int64", "uint64"):
                return f"str({name})" if node.type.kind == "scalar" else f"[str(i) for i in {name}]"
            return name
        return "{" + ", ".join(f"{name!r}: {self.expression(inner)}" for name, inner in node.fields) + "}"

    def align(self, to: int) -> None:
        # positions count from the end of the 4-byte header
        if to == 8:
            self.line("p = (p + 3 & -8) + 4")
        elif to > 1:
            self.line(f"p = p + {to - 1} & -{to}")

    def steps(self, steps: list[Step]) -> None:
        for step in steps:
            if isinstance(step, Run):
                self.run(step)
            elif isinstance(step, Text):
                self.text(step.leaf)
            elif isinstance(step, Numbers):
                self.numbers(step)
            elif isinstance(step, Loop):
                self.loop(step)
            else:
                self.call(step)

    def run(self, run: Run) -> None:
        self.align(run.align)
        targets: list[_Target] = []
        after = []
        code = "<"
        for slot in run.slots:
            if slot.use == "pad":
                code += f"{slot.count}x"
            elif slot.use == "length":
                targets.append(_Target(f"n{_index(slot)}", slot.code))
                code += slot.code
            elif slot.leaf is not None and slot.leaf.type.kind == "scalar":
                targets.append(_Target(f"v{slot.leaf.index}", slot.code))
                code += slot.code
            elif self.as_tuple(slot):
                targets.append(_Target(f"v{_index(slot)}", slot.code, slot.count))
                code += f"{slot.count}{slot.code}"
            else:
                assert slot.leaf is not None
                size = slot.count * struct.calcsize(slot.code)
                code += f"{size}x"
                start = f"p + {slot.offset}" if slot.offset else "p"
                made = self.array(slot.leaf, start, str(slot.count), f"p + {slot.offset + size}")
                after.append(f"v{slot.leaf.index} = {made}")
        self.unpack(targets, code)
        if self.flavour in ("cbor", "rosgw"):
            self.widen(targets)
        for text in after:
            self.line(text)
        self.line(f"p += {run.size}")
        for slot in run.slots:
            if slot.use == "length" and slot.leaf is not None:
                self.limit(slot.leaf)

    def unpack(self, targets: list[_Target], code: str) -> None:
        if not targets:
            self.line(f"if p + {struct.calcsize(code)} > end: raise Short")
            return
        self.runs += 1
        unpack = self.constant(f"u{self.runs}", struct.Struct(code).unpack_from)
        if not any(target.length for target in targets):
            self.line(", ".join(target.name for target in targets) + f", = {unpack}(raw, p)")
            return
        self.line(f"t = {unpack}(raw, p)")
        position = 0
        for name, letter, count in targets:
            if not count:
                self.line(f"{name} = t[{position}]")
            else:
                cut = f"t[{position}:{position + count}]"
                self.line(f"{name} = {cut if self.flavour == 'json' and letter != '?' else f'list({cut})'}")
            position += count or 1

    def widen(self, targets: list[_Target]) -> None:
        """Make ``cbor.dumps`` write NaN and infinity in full."""
        names = [name for name, letter, count in targets if letter in "fd" and not count]
        lists = [name for name, letter, count in targets if letter in "fd" and count]
        if not names and not lists:
            return
        total = " + ".join([*names, *(f"sum({name})" for name in lists)])
        self.constant("wide", cbor.wide)
        self.line(f"if not {self.constant('isfinite', math.isfinite)}({total}):")
        for name in names:
            self.line(f" {name} = wide({name})")
        for name in lists:
            self.line(f" {name} = list(map(wide, {name}))")

    def as_tuple(self, slot: Slot) -> bool:
        """Return whether an array of fixed size is best unpacked together with its neighbours."""
        assert slot.leaf is not None
        base = slot.leaf.type.base
        if base == "bool":
            return True
        if self.flavour == "json":
            return base not in ("uint8", "char") and slot.count <= _TUPLE_LIMIT
        return self.flavour == "cbor"

    def limit(self, leaf: Leaf) -> None:
        type = leaf.type
        if type.kind == "sequence" and type.size:
            self.line(f"if n{leaf.index} > {type.size}: raise Short('a sequence is longer than its type allows')")

    def text(self, leaf: Leaf) -> None:
        n, v = f"n{leaf.index}", f"v{leaf.index}"
        bound = leaf.type.bound
        if not self.cdr:
            if bound and leaf.type.base == "string":
                self.line(f"if {n} > {bound}: raise Short('a string is longer than its type allows')")
            self.line(f"q = p + {n}")
            self.line("if q > end: raise Short")
            self.line(f"{v} = str(raw[p:q], 'utf-8', 'replace')")
        elif leaf.type.base == "wstring":
            if bound:
                self.line(f"if {n} > {bound}: raise Short('a wstring is longer than its type allows')")
            self.line(f"q = p + 4 * {n}")
            self.line("if q > end: raise Short")
            self.line(f"{v} = {self.constant('read_wide', values.read_wide)}(raw, p, {n})")
        else:
            if bound:
                self.line(f"if {n} > {bound + 1}: raise Short('a string is longer than its type allows')")
            self.line(f"q = p + {n}")
            self.line("if q > end: raise Short")
            self.line(f"if {n}:")
            self.line(" if raw[q - 1]: raise Short('a string does not end with NUL')")
            self.line(f" {v} = str(raw[p:q - 1], 'utf-8', 'replace')")
            self.line(f"else: {v} = ''")
        self.line("p = q")

    def numbers(self, step: Numbers) -> None:
        leaf = step.leaf
        n, size = f"n{leaf.index}", PRIMITIVES[leaf.type.base]
        if step.align > 1:
            self.line(f"if {n}:")
            self.indent += 1
            self.align(step.align)
            self.indent -= 1
        self.line(f"q = p + {n}" + (f" * {size}" if size > 1 else ""))
        self.line("if q > end: raise Short")
        self.line(f"v{leaf.index} = {self.array(leaf, 'p', n, 'q')}")
        self.line("p = q")

    def array(self, leaf: Leaf, start: str, count: str, end: str) -> str:
        """Return an expression for the numbers of ``leaf`` at ``raw[start:end]``."""
        type, base = leaf.type, leaf.type.base
        cut = f"raw[{start}:{end}]"
        if base == "bool":
            return f"list(map(bool, {cut}))"
        if self.flavour == "json":
            if base in ("uint8", "char") and not (type.kind == "sequence" and type.size):
                return f"{self.constant('base64_text', values.base64_text)}(raw, {start}, {end})"
            if base in ("uint8", "char", "byte"):
                return f"list({cut})"
            return f"{self.constant('json_numbers', values.json_numbers)}(raw, {start}, {count}, {CODES[base]!r})"
        if self.flavour == "cbor" and type.kind == "sequence" and type.size and base != "byte":
            return f"{self.constant('plain_numbers', cbor.plain_numbers)}(raw, {start}, {count}, {CODES[base]!r})"
        if base in ("uint8", "char", "byte") or self.flavour == "rosgw":
            return cut
        if self.flavour == "cbor":
            return f"{self.constant('Tag', cbor2.CBORTag)}({_TAGS[base]}, {cut})"
        import numpy as np

        dtype = self.constant(f"dtype_{base}", np.dtype(f"<{CODES[base]}"))
        return f"{self.constant('frombuffer', np.frombuffer)}(raw, {dtype}, {count}, {start})"

    def loop(self, step: Loop) -> None:
        type, name = step.leaf.type, f"v{step.leaf.index}"
        count = f"n{step.leaf.index}" if type.kind == "sequence" else str(type.size)
        if step.minimum:
            self.line(f"if {count} * {step.minimum} > end - p: raise Short")
        else:
            self.empties.wanted = True
            self.line(f"{self.constant('take', self.empties.take)}({count})")
        self.line(f"{name} = []")
        self.line(f"for _ in range({count}):")
        self.indent += 1
        self.steps(step.steps)
        self.line(f"{name}.append({self.expression(step.node)})")
        self.indent -= 1

    def call(self, step: Call) -> None:
        key = id(step.plan)
        if key not in self.made:
            self.made[key] = self.inner().function(step.plan)
        function = self.constant(f"f{step.leaf.index}", self.made[key])
        self.line(f"v{step.leaf.index}, p = {function}(raw, p, end)")


def _index(slot: Slot) -> int:
    assert slot.leaf is not None
    return slot.leaf.index
