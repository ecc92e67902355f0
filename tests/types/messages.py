"""Random messages of any type, and how to compare two of them."""

from __future__ import annotations

import random
import struct
from typing import Any

import numpy as np
from rosbags.typesys.base import normalize_fieldname
from rosbags.typesys.store import Typestore

from ropeway.types import TypeRegistry
from ropeway.types.definition import FieldType
from ropeway.types.layout import CODES

LETTERS = 'abcXYZ 09/_"\\\n\téß漢🚀'

MATRIX = {
    "probe/msg/Inner": "uint8 a\nfloat64 b\nstring c\n",
    "probe/msg/Empty": "",
    "probe/msg/Constants": "int32 ONE=1\nstring TEXT='a # b'\n",
    "probe/msg/Times": "time stamp\nduration span\ntime[2] pair\nduration[] many\n",
    "probe/msg/Scalars": "\n".join(
        f"{base} {base}_value" for base in (*CODES, "string", "wstring", "string<=5", "wstring<=5") if "<" not in base
    )
    + "\nstring<=5 short_text\nwstring<=5 short_wide\nuint8 last\n",
    "probe/msg/Arrays": "\n".join(f"{base}[3] {base}_values" for base in (*CODES, "string", "wstring"))
    + "\nInner[2] inners\nEmpty[2] empties\nuint8 last\n",
    "probe/msg/Ones": "\n".join(f"{base}[1] {base}_values" for base in (*CODES, "string", "wstring"))
    + "\nInner[1] inners\nEmpty[1] empties\nuint8 last\n",
    "probe/msg/Sequences": "\n".join(f"{base}[] {base}_values" for base in (*CODES, "string", "wstring"))
    + "\nInner[] inners\nEmpty[] empties\nuint8 last\n",
    "probe/msg/Bounded": "\n".join(f"{base}[<=3] {base}_values" for base in (*CODES, "string", "wstring"))
    + "\nInner[<=2] inners\nstring<=4[<=2] texts\nwstring<=4[2] wides\nuint8 last\n",
    "probe/msg/Mixed": "uint8 a\nfloat64 b\nbool c\nint16 d\nEmpty e\nfloat32 f\nuint64[] g\nint16[3] h\nint64 i\n"
    "string[] j\nfloat64 k\nInner[] l\nfloat64 m\nwstring n\nfloat64 o\n",
    "probe/msg/Deep0": "uint8 a\nfloat64[] b\n",
    **{f"probe/msg/Deep{n}": f"uint8 a\nDeep{n - 1}[] b\nDeep{n - 1}[2] c\n" for n in range(1, 4)},
    **{f"probe/msg/Deep{n}": f"uint8 a\nDeep{n - 1}[] b\nDeep{n - 1} c\n" for n in range(4, 6)},
    "probe/msg/Long": "".join(f"Inner i{n}\nstd_msgs/Header h{n}\nuint8 u{n}\n" for n in range(60)),
    "probe/msg/Defaults": 'int32 a 7\nfloat32 b -1.5\nstring c "x, y"\nbool d true\nint32[] e [1, 2, 3]\n'
    'float64[2] f [0.5, 1]\nstring[] g ["p", "q, r"]\nuint8[2] h [1, 255]\nwstring i "w"\nstring<=9 j \'k\'\n',
}
"""Definitions that have every kind of field in every kind of neighbourhood."""


def probe_registry() -> TypeRegistry:
    """The default registry with ``MATRIX``."""
    registry = TypeRegistry()
    for name, text in MATRIX.items():
        registry.add_text(name, text)
    return registry


def random_message(registry: TypeRegistry, name: str, rng: random.Random, *, finite: bool = False) -> dict[str, Any]:
    """A message as ``decode`` gives it."""
    return {
        field.name: random_field(registry, field.type, rng, finite) for field in registry.definition(name).wire_fields
    }


def random_field(registry: TypeRegistry, type: FieldType, rng: random.Random, finite: bool) -> Any:
    """A value of one field as ``decode`` gives it."""
    if type.kind == "scalar":
        return _scalar(registry, type, rng, finite)
    longest = min(type.size or 4, 4)
    count = type.size if type.kind == "array" else rng.randint(0, longest)
    inner = FieldType(type.base, type.bound)
    items = [_scalar(registry, inner, rng, finite) for _ in range(count)]
    if type.base in ("uint8", "char", "byte"):
        return bytes(items)
    if type.base in CODES and type.base != "bool":
        return np.array(items, "<" + CODES[type.base])
    return items


def _scalar(registry: TypeRegistry, type: FieldType, rng: random.Random, finite: bool) -> Any:
    base = type.base
    if type.is_message:
        return random_message(registry, base, rng, finite=finite)
    if base in ("string", "wstring"):
        text = "".join(rng.choices(LETTERS, k=rng.randint(0, 9)))
        while type.bound and len(text.encode()) > type.bound:
            text = text[:-1]
        return text
    if base == "bool":
        return rng.random() < 0.5
    if base in ("float32", "float64"):
        specials = [] if finite else [float("nan"), float("inf"), float("-inf")]
        value = rng.choice([0.0, -0.0, 1.5, rng.uniform(-1e6, 1e6), *specials])
        return struct.unpack("<f", struct.pack("<f", value))[0] if base == "float32" else value
    bits = 8 * struct.calcsize(CODES[base])
    low = -(1 << bits - 1) if CODES[base].islower() else 0
    return rng.choice([low, low + (1 << bits) - 1, rng.randint(low, low + (1 << bits) - 1), max(low, 1)])


def rosbags_object(registry: TypeRegistry, store: Typestore, name: str, message: dict[str, Any]) -> Any:
    """The message as rosbags wants it; it packs a byte signed."""
    made: dict[str, Any] = {}
    for field in registry.definition(name).wire_fields:
        value = message[field.name]
        if field.type.is_message:
            inner = field.type.base
            many = field.type.kind != "scalar"
            value = [rosbags_object(registry, store, inner, item) for item in (value if many else [value])]
            value = value if many else value[0]
        elif isinstance(value, bytes):
            value = np.frombuffer(value, np.uint8)
        elif field.type.kind != "scalar" and field.type.base == "bool":
            value = np.array(value, np.bool_)
        elif field.type.base == "byte":
            value = value - 256 if value > 127 else value
        made[normalize_fieldname(field.name)] = value
    if not made and store.fielddefs[name][1]:
        made = {"structure_needs_at_least_one_member": 0}
    return store.types[name](**made)


def same(a: Any, b: Any) -> bool:
    """True if two values hold the same message, NaN being equal to NaN."""
    if isinstance(a, dict):
        return isinstance(b, dict) and list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, (np.ndarray, list, tuple)):
        return len(a) == len(b) and all(same(x, y) for x, y in zip(list(a), list(b), strict=True))
    if isinstance(a, (float, np.floating)):
        return bool(a == b or (a != a and b != b))
    return bool(a == b)
