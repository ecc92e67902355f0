"""Shows why a name crosses or does not."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Final

from nicegui import ui

from ropeway.dashboard.answers import ExplanationRow

__all__ = ["show_explanation"]

_MARKS: Final = {True: ("check_circle", "positive"), False: ("cancel", "negative"), None: ("help", "grey")}


def show_explanation(explanations: Sequence[ExplanationRow]) -> None:
    """Show an answer of ``/v1/explain`` in a dialog."""
    with ui.dialog(value=True) as dialog, ui.card().classes("q-pa-md"):
        for each in explanations:
            verdict = "crosses" if each.crosses else "does not cross"
            ui.label(f"{each.name} {verdict}").classes("text-h6 wraps")
            ui.label(f"{each.source} → {each.target}").classes("text-caption wraps")
            for finding in each.findings:
                icon, colour = _MARKS[finding.ok]
                with ui.row().classes("no-wrap items-start"):
                    ui.icon(icon, color=colour, size="sm")
                    ui.label(finding.text).classes("wraps")
        if not explanations:
            ui.label("The gateway knows nothing of it.")
        ui.button("Close", on_click=dialog.close).props("flat no-caps")
    dialog.on("hide", dialog.delete)
