"""The floors of what the tests reach."""

from __future__ import annotations

from typing import Any

from tests.floors import MODULE, TOTAL, complaints


def report(total: float, **modules: float) -> dict[str, Any]:
    """What ``coverage json`` writes, as far as it is read."""
    files = {f"src/ropeway/{name}.py": {"summary": {"percent_covered": reached}} for name, reached in modules.items()}
    return {"totals": {"percent_covered": total}, "files": files}


def test_floors() -> None:
    """What is above its floor passes; a module or a total below it is told."""
    assert complaints(report(TOTAL, a=MODULE, b=100)) == []
    assert complaints(report(TOTAL, a=MODULE - 0.1)) == [f"a.py: {MODULE - 0.1:.1f} %, less than {MODULE:g} %"]
    assert complaints(report(TOTAL - 1, a=100)) == [f"{TOTAL - 1:.1f} % of all lines, less than {TOTAL:g} %"]
