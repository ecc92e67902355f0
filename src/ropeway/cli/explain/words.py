"""Writes explanations for people: a heading per route, a line per step, and the verdict."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from ropeway.cli.console import MARKS

__all__ = ["lines"]


def lines(explanations: Sequence[dict[str, Any]]) -> Iterator[str]:
    """Yield the lines that tell explanations, as the control API gives them."""
    for explanation in explanations:
        way = f" {explanation['source']} -> {explanation['target']}" if explanation["source"] else ""
        path = f" ({explanation['path']})" if explanation["path"] else ""
        yield f"{explanation['name']}{way}{path}"
        for finding in explanation["findings"]:
            yield f"  {MARKS[finding['ok']]}  {finding['text']}"
        wrong = [finding["text"] for finding in explanation["findings"] if finding["ok"] is False]
        if wrong:
            yield f"It does not cross: {wrong[0]}"
        elif any(finding["ok"] is None for finding in explanation["findings"]):
            yield "Nothing is known to be in its way."
        else:
            yield "It crosses."
