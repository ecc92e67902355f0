"""Tables of figures, for people and as JSON lines."""

from __future__ import annotations

import json
from typing import Any

__all__ = ["table"]


def table(title: str, heads: list[str], rows: list[list[Any]], *, as_json: bool = False) -> None:
    """Print one table."""
    if as_json:
        for row in rows:
            print(json.dumps({"table": title, **dict(zip(heads, row, strict=True))}))
        return
    cells = [[_cell(value) for value in row] for row in rows]
    widths = [max(len(h), *(len(r[i]) for r in cells)) if cells else len(h) for i, h in enumerate(heads)]
    print(f"\n{title}")
    print("  ".join(h.rjust(w) for h, w in zip(heads, widths, strict=True)))
    for row in cells:
        print("  ".join(c.rjust(w) for c, w in zip(row, widths, strict=True)))


def _cell(value: Any) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 10 else f"{value:.1f}"
    return str(value)
