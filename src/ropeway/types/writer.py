"""Makes the functions that write messages: from nested dicts to bytes.

A writer is Python source generated from a plan. It takes what ``decode`` gives as well as what JSON and CBOR peers
send: missing fields get their defaults, arrays may be lists, base64, bytes, typed arrays or numpy arrays. A value
that does not fit makes it fail in any way (``FAILURES``); ``check`` then says where and why.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from typing import Any, Final

from ropeway.types import values
from ropeway.types.definition import HEADER, PRIMITIVES, ROS1_TIMES, TIMES
from ropeway.types.layout import CODES, Call, Leaf, Loop, Numbers, Plan, Run, Slot, Step, Struct, Text

__all__ = ["FAILURES", "Writer", "make_writer"]

FAILURES: Final = (
    values.Misfit,
    struct.error,
    TypeError,
    ValueError,
    OverflowError,
    AttributeError,
    KeyError,
    RecursionError,
)

Writer = Callable[[Any, list[bytes], int], int]
"""``(value, pieces, position) -> position``: appends to ``pieces``; positions count from the CDR header's end."""

_PADDING: Final = tuple(bytes(count) for count in range(8))
_EMPTY: Final[dict[str, Any]] = {}


def make_writer(plan: Plan) -> Writer:
    """Make the function that writes messages of this plan."""
    return _Source(plan.layout, {}).function(plan)


class _Source:
    def __init__(self, layout: str, made: dict[int, Writer]) -> None:
        self.cdr = layout == "cdr"
        self.layout, self.made = layout, made
        self.lines: list[str] = []
        self.scope: dict[str, Any] = {
            "EMPTY": _EMPTY,
            "Misfit": values.Misfit,
            "PADDING": _PADDING,
            "mapping": values.mapping,
        }
        self.indent = 1
        self.names = 0

    def function(self, plan: Plan) -> Writer:
        self.line("w = out.append")
        self.struct(plan.node, "value")
        self.steps(plan.steps)
        source = "\n".join(["def write(value, out, p):", *self.lines, " return p"])
        exec(compile(source, f"<writer of {plan.type}>", "exec"), self.scope)  # noqa: S102
        made: Writer = self.scope["write"]
        return made

    def line(self, text: str) -> None:
        self.lines.append(" " * self.indent + text)

    def constant(self, name: str, value: object) -> str:
        self.scope[name] = value
        return name

    def unique(self, prefix: str, value: object) -> str:
        self.names += 1
        return self.constant(f"{prefix}{self.names}", value)

    def struct(self, node: Struct, name: str) -> None:
        """Take the fields of the dict called ``name`` apart into local variables."""
        names = [field for field, _ in node.fields]
        if (node.type in TIMES and names == ["sec", "nanosec"]) or node.type in ROS1_TIMES:
            targets = ", ".join(f"v{leaf.index}" for _, leaf in node.fields if isinstance(leaf, Leaf))
            self.line(f"{targets} = {self.constant('time_parts', values.time_parts)}({name})")
            return
        self.line(f"if {name}.__class__ is not dict: {name} = mapping({name})")
        known = frozenset((*names, "seq") if node.type == HEADER else names)  # clients of ROS 1 number their headers
        self.line(f"if not {self.unique('known', known.issuperset)}({name}): raise Misfit")
        if not names:
            return
        self.names += 1
        get = f"get{self.names}"
        self.line(f"{get} = {name}.get")
        for field, inner in node.fields:
            if isinstance(inner, Leaf):
                self.line(f"v{inner.index} = {get}({field!r}, {self.unique('default', _default(inner))})")
            else:
                self.names += 1
                below = f"s{self.names}"
                self.line(f"{below} = {get}({field!r}, EMPTY)")
                self.struct(inner, below)

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

    def align(self, to: int) -> None:
        self.line(f"if p & {to - 1}: w(PADDING[-p & {to - 1}]); p = p + {to - 1} & -{to}")

    def run(self, run: Run) -> None:
        if run.align > 1:
            self.align(run.align)
        code, arguments = "<", []
        for slot in run.slots:
            if slot.use == "pad":
                code += f"{slot.count}x"
            elif slot.use == "length":
                arguments.append(self.length(slot))
                code += slot.code
            else:
                arguments.append(self.value(slot))
                code += slot.code if slot.leaf is not None and slot.leaf.type.kind == "scalar" else _bytes_code(slot)
        pack = self.unique("pack", struct.Struct(code).pack)
        self.line(f"w({pack}({', '.join(arguments)}))")
        self.line(f"p += {run.size}")

    def value(self, slot: Slot) -> str:
        """Bring the value of a slot to what ``pack`` takes, and give its name."""
        leaf = slot.leaf
        assert leaf is not None
        name, base = f"v{leaf.index}", leaf.type.base
        if leaf.type.kind != "scalar":
            self.line(f"{name} = {self.array(base)}({name}, {slot.count}, 0)")
        elif base == "bool":
            truth = self.constant("truth", values.truth)
            self.line(f"if {name} is not True and {name} is not False: {name} = {truth}({name})")
        elif base in ("float32", "float64"):
            self.line(f"if {name}.__class__ is not float: {name} = {self.constant('real', values.real)}({name})")
        else:
            whole = self.constant("byte", values.byte) if base == "byte" else self.constant("whole", values.whole)
            self.line(f"if {name}.__class__ is not int: {name} = {whole}({name})")
        return name

    def length(self, slot: Slot) -> str:
        """Bring a value of varying size to its bytes (or a checked list), and give an expression of its length."""
        leaf = slot.leaf
        assert leaf is not None
        type, name = leaf.type, f"v{leaf.index}"
        if type.kind == "sequence":
            size = PRIMITIVES.get(type.base, 0)
            if not size:
                self.items(leaf, -1)
                return f"len({name})"
            self.line(f"{name} = {self.array(type.base)}({name}, -1, {type.size})")
            return f"len({name})" + (f" // {size}" if size > 1 else "")
        if type.base == "wstring" and self.cdr:
            self.line(f"{name} = {self.constant('wide', values.wide)}({name}, {type.bound})")
            return f"len({name}) // 4"
        coded = f"{self.constant('text', values.text)}({name}, {type.bound})"
        if type.bound:
            self.line(f"{name} = {coded}")
        else:
            self.line(f"{name} = {name}.encode() if {name}.__class__ is str else {coded}")
        return f"len({name}) + 1" if self.cdr else f"len({name})"

    def items(self, leaf: Leaf, count: int) -> None:
        name, limit = f"v{leaf.index}", leaf.type.size if leaf.type.kind == "sequence" else 0
        made = f"{self.constant('items', values.items)}({name}, {count}, {limit})"
        if count < 0 and not limit:
            self.line(f"if {name}.__class__ is not list: {name} = {made}")
        else:
            self.line(f"{name} = {made}")

    def array(self, base: str) -> str:
        """Return the name of the function that gives the bytes of an array of ``base``."""
        if base == "bool":
            return self.constant("truths", values.truths)
        if base in ("uint8", "char", "byte"):
            return self.constant("octets", values.octets)
        return self.constant(f"numbers_{base}", _packer(base))

    def text(self, leaf: Leaf) -> None:
        name = f"v{leaf.index}"
        if self.cdr and leaf.type.base == "string":
            self.line(f"w({name} + b'\\0'); p += len({name}) + 1")
        else:
            self.line(f"w({name}); p += len({name})")

    def numbers(self, step: Numbers) -> None:
        name = f"v{step.leaf.index}"
        self.line(f"if {name}:")
        self.indent += 1
        if step.align > 1:
            self.align(step.align)
        self.line(f"w({name}); p += len({name})")
        self.indent -= 1

    def loop(self, step: Loop) -> None:
        leaf = step.leaf
        if leaf.type.kind == "array":
            self.items(leaf, leaf.type.size)
        inner = f"v{step.node.index}" if isinstance(step.node, Leaf) else f"e{leaf.index}"
        self.line(f"for {inner} in v{leaf.index}:")
        self.indent += 1
        if isinstance(step.node, Struct):
            self.struct(step.node, inner)
        self.steps(step.steps)
        self.indent -= 1

    def call(self, step: Call) -> None:
        key = id(step.plan)
        if key not in self.made:
            self.made[key] = _Source(self.layout, self.made).function(step.plan)
        function = self.constant(f"f{step.leaf.index}", self.made[key])
        self.line(f"p = {function}(v{step.leaf.index}, out, p)")


_packers: dict[str, Callable[[Any, int, int], bytes]] = {}


def _packer(base: str) -> Callable[[Any, int, int], bytes]:
    if base not in _packers:
        _packers[base] = values.number_packer(CODES[base])
    return _packers[base]


def _bytes_code(slot: Slot) -> str:
    return f"{slot.count * struct.calcsize(slot.code)}s"


def _default(leaf: Leaf) -> Any:
    """Return the value of a missing field, in the form that the writer takes fastest."""
    type = leaf.type
    if leaf.default is not None:
        return leaf.default
    if type.kind == "scalar":
        if type.is_message:
            return _EMPTY
        if type.base in ("string", "wstring"):
            return ""
        return False if type.base == "bool" else 0.0 if type.base.startswith("float") else 0
    if type.is_message or not PRIMITIVES[type.base]:
        return [_EMPTY if type.is_message else ""] * (type.size if type.kind == "array" else 0)
    size = PRIMITIVES[type.base]
    return bytes(type.size * size) if type.kind == "array" else b""
