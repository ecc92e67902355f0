"""Turns big-endian CDR into little-endian CDR, so that everything else need know only one byte order."""

from __future__ import annotations

import struct

from ropeway.types.definition import PRIMITIVES
from ropeway.types.layout import Loop, Numbers, Plan, Run, Step, Text
from ropeway.types.values import Short

__all__ = ["to_little_endian"]


def to_little_endian(plan: Plan, raw: bytes) -> bytes:
    """Return the same message in little-endian order, with its header saying so.

    Raises ``Short`` or ``struct.error`` where ``raw`` is not such a message.
    """
    out = bytearray(raw)
    out[1] = 1
    _steps(plan.steps, raw, out, 4, {})
    return bytes(out)


def _steps(steps: list[Step], raw: bytes, out: bytearray, position: int, lengths: dict[int, int]) -> int:
    for step in steps:
        if isinstance(step, Run):
            position = _run(step, raw, out, _aligned(position, step.align), lengths)
        elif isinstance(step, Text):
            wide = step.leaf.type.base == "wstring"
            position = _numbers(raw, out, position, lengths[step.leaf.index], 4 if wide else 1)
        elif isinstance(step, Numbers):
            count = lengths[step.leaf.index]
            if count:
                position = _aligned(position, step.align)
            position = _numbers(raw, out, position, count, PRIMITIVES[step.leaf.type.base])
        elif isinstance(step, Loop):
            type = step.leaf.type
            count = lengths[step.leaf.index] if type.kind == "sequence" else type.size
            if count * step.minimum > len(raw) - position:
                raise Short
            for _ in range(count):
                position = _steps(step.steps, raw, out, position, lengths)
        else:
            position = _steps(step.plan.steps, raw, out, position, {})
    return position


def _run(run: Run, raw: bytes, out: bytearray, position: int, lengths: dict[int, int]) -> int:
    if position + run.size > len(raw):
        raise Short
    for slot in run.slots:
        if slot.use == "length" and slot.leaf is not None:
            lengths[slot.leaf.index] = struct.unpack_from(">I", raw, position + slot.offset)[0]
        if slot.use != "pad":
            _numbers(raw, out, position + slot.offset, slot.count, struct.calcsize(slot.code))
    return position + run.size


def _numbers(raw: bytes, out: bytearray, start: int, count: int, size: int) -> int:
    end = start + count * size
    if end > len(raw):
        raise Short
    for place in range(size):
        out[start + place : end : size] = raw[start + size - 1 - place : end : size]
    return end


def _aligned(position: int, to: int) -> int:
    return position + (4 - position) % to
