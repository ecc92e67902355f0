"""Writes ``docs/limits.md`` from the module of the limits: ``python -m tests.limits_page``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Final

from ropeway import iort, limits

__all__ = ["PAGE", "written"]

PAGE: Final = Path(__file__).parents[1] / "docs" / "limits.md"
_HEAD: Final = """\
# Limits

What peers may send, at most. What is above is refused with an error that says so; of what waits, the oldest is dropped
and counted with its reason. None of these is configured: what depends on the robot, such as `max_message_bytes` and
`max_clients`, is in [configuration.md](configuration.md). The values stand in `src/ropeway/limits.py`, and
`python -m tests.limits_page` writes this page from it.
"""
_TITLE: Final = re.compile(r"^# ── (.*?) ─+$|^([A-Z][A-Z0-9_]*): Final = .*\n\"\"\"((?s:.*?))\"\"\"$", re.MULTILINE)
_LONE: Final = re.compile(r"^(_?[A-Z][A-Z0-9_]*) = [0-9].*\n\"\"\"((?s:.*?))\"\"\"$", re.MULTILINE)
_LONE_HEAD: Final = """
## Nodes and local servers

These stand in `src/ropeway/iort.py`, which is one file for robots. A gateway that nodes connect to has those above.

| limit | value | what for |
|---|---|---|
"""
_COUNTED: Final = ("characters", "samples", "elements")
_SIZES: Final = ((1 << 30, "GiB"), (1 << 20, "MiB"), (1 << 10, "KiB"), (1, "bytes"))


def written() -> str:
    """Return the page."""
    lines = [_HEAD]
    for title, name, reason in _TITLE.findall(Path(limits.__file__).read_text()):
        if title:
            lines.append(f"\n## {title}\n\n| limit | value | what for |\n|---|---|---|\n")
        else:
            lines.append(f"| `{name}` | {_value(name, getattr(limits, name))} | {' '.join(reason.split())} |\n")
    lines.append(_LONE_HEAD)
    for name, reason in _LONE.findall(Path(iort.__file__).read_text()):
        if "PORT" not in name:
            value = _value(name, getattr(iort, name))
            lines.append(f"| `{name.lstrip('_')}` | {value} | {' '.join(reason.split())} |\n")
    return "".join(lines)


def _value(name: str, value: float) -> str:
    """Return the value with the unit that its name tells."""
    words = name.lower().split("_")
    if words[-2:] == ["per", "s"]:
        return f"{value:,g} per second"
    if words[-1] in ("s", "ms"):
        seconds = value / 1000 if words[-1] == "ms" else value
        return f"{seconds:,g} s" if seconds < 1000 else f"{seconds:,.0f} s"
    if "bytes" in words:
        size, unit = next((size, unit) for size, unit in _SIZES if value % size == 0)
        return f"{value // size:,} {unit}"
    return f"{value:,} {next((word for word in _COUNTED if word in words), '')}".rstrip()


if __name__ == "__main__":
    PAGE.write_text(written())
