"""The configuration of a gateway: an editor with its schema, plan, apply, and the history with roll-back."""

from __future__ import annotations

import asyncio
import json
import time
from functools import cache
from typing import Any, Final

from nicegui import ui

from ropeway.dashboard.answers import ConfigAnswer, HistoryRow, PlanAnswer, StepRow, read
from ropeway.dashboard.frame import Page
from ropeway.dashboard.tables import fill, make_table
from ropeway.dashboard.watch import GatewayWatch
from ropeway.errors import ConfigError, ControlRefused, RopewayError
from ropeway.gateway.config import schema
from ropeway.tasks import describe

__all__ = ["make"]

_COLUMNS: Final = {
    "number": "change",
    "time": "when",
    "action": "action",
    "state": "state",
    "who": "who",
    "what": "what",
    "more": "",
}
_BACK: Final = """<q-btn flat dense no-caps color="primary" label="go back to it"
:disable="!props.row.may" :title="props.row.may ? '' : 'your role lacks the right configure'"
@click="() => $parent.$emit('back', props.row.id)"/>"""
_CARD: Final = f"""<div class="q-pa-xs col-12"><q-card flat bordered class="q-pa-sm"><div class="wraps">
{{{{ props.row.number }}}} {{{{ props.row.action }}}} ({{{{ props.row.state }}}}) by {{{{ props.row.who }}}},
{{{{ props.row.time }}}}</div><div class="text-caption wraps">{{{{ props.row.what }}}}</div>{_BACK}</q-card></div>"""
_EDITOR_S: Final = 10.0
_HISTORY: Final = 50
_CONFLICT: Final = 409


def make(page: Page) -> None:
    """Make the page."""
    if page.watch is not None:
        _Editing(page, page.watch)


class _Editing:
    """The editor of one page, and the configuration that it began with."""

    def __init__(self, page: Page, watch: GatewayWatch) -> None:
        self._page, self._watch = page, watch
        self._etag = ""
        self._history_of = ""
        if watch.may("configure"):
            self._place = ui.element("div").classes("full-width").style("height: 55vh").mark("editor")
            self._editor: ui.json_editor | None = None
        else:
            ui.label(f'{watch.caller.name or "This login"} lacks the right "configure", so it sees the history alone.')
        with ui.row().classes("items-center"):
            page.button("Plan", "configure", self._plan, icon="checklist")
            page.button("Apply", "configure", self._apply, icon="check", colour="positive")
            page.button("Read again", "configure", self._load, icon="refresh")
            self._note = ui.input("Note for the history").props("dense maxlength=1000")
        self._said = ui.label().classes("wraps full-width").mark("plan")
        ui.label("History").classes("text-h6")
        slots = {"body-cell-more": f'<q-td :props="props">{_BACK}</q-td>', "item": _CARD}
        self._table = make_table(_COLUMNS, "No change is remembered.", slots=slots, wide=("state", "who"))
        self._table.on("back", self._roll_back)
        page.every(self._first)

    async def _first(self) -> None:
        """Load once the gateway answers."""
        if self._watch.status is not None:
            self._page.updates.remove(self._first)
            if self._watch.may("configure"):
                await self._load()
            await self._show_history()

    async def _load(self) -> None:
        found = await self._page.fetch(ConfigAnswer, "/v1/config")
        if found is None:
            return
        self._etag = found.etag
        content = {"content": {"json": found.config}, "mode": "text"}
        if self._editor is None:
            known = await _schema()
            with self._place:
                self._editor = ui.json_editor(content, schema=known).classes("full-width").style("height: 55vh")
        else:
            self._editor.properties.update(content)
        self._said.set_text(f"The configuration that runs, from {found.source}" if found.source else "")

    async def _written(self) -> Any:
        """Return what stands in the editor. Raises ``ControlRefused`` where it is not JSON."""
        assert self._editor is not None
        content = await self._editor.run_editor_method("get", timeout=_EDITOR_S)
        if "json" in content:
            return content["json"]
        try:
            return json.loads(content.get("text", ""))
        except (ValueError, RecursionError) as error:
            raise ControlRefused(422, f"this is not JSON: {error}") from None

    async def _plan(self) -> None:
        planned = await self._ask("POST", "/v1/config/plan")
        if planned:
            self._said.set_text(f"What would be done:\n{planned}")

    async def _apply(self) -> None:
        done = await self._ask("PUT", "/v1/config")
        if done:
            await self._load()  # before anybody hears that it is done, and writes on
            self._said.set_text(f"This was done:\n{done}")
            await self._show_history()

    async def _ask(self, method: str, path: str) -> str:
        """Return what the gateway would do or has done, ``""`` where it refused, which is said then."""
        if self._editor is None or not self._page.viewer.active:
            return ""
        try:
            body = {"config": await self._written()}
            if method == "PUT":
                body["note"] = self._note.value
            headers = {"if-match": f'"{self._etag}"'} if method == "PUT" else {}
            answer = await self._watch.client.request(method, path, body=body, headers=headers)
            return _plan_text(read(PlanAnswer, answer))
        except ConfigError as error:
            self._said.set_text("\n".join(f"{path}: {text}" for path, text in error.problems))
        except ControlRefused as error:
            meanwhile = error.details.get("meanwhile") if error.status == _CONFLICT else None
            steps = "\n".join(map(_step_text, read(list[StepRow], meanwhile))) if meanwhile else ""
            self._said.set_text(f"{error}\n{steps}".strip())
        except (RopewayError, TimeoutError) as error:
            self._said.set_text(describe(error))
        return ""

    async def _roll_back(self, event: Any) -> None:
        number = event.args
        if not isinstance(number, int):
            return
        body = {"number": number}
        done = await self._page.do(lambda: self._watch.client.post("/v1/config/rollback", body), "went back")
        if done is not None:
            await self._load()
            self._said.set_text(f"This was done:\n{_plan_text(read(PlanAnswer, done))}")
            await self._show_history()

    async def _show_history(self) -> None:
        found = await self._page.fetch(list[HistoryRow], "/v1/config/history", count=_HISTORY)
        if found is not None:
            fill(self._table, [self._row(entry) for entry in found])

    def _row(self, entry: HistoryRow) -> dict[str, Any]:
        when = time.strftime("%Y-%m-%d %H:%M", time.localtime(min(max(entry.time, 0.0), 4e9)))
        steps = "; ".join(map(_step_text, entry.steps[:5])) + ("; …" if len(entry.steps) > 5 else "")
        return {
            "id": entry.number,
            "number": str(entry.number),
            "time": when,
            "action": entry.action,
            "state": entry.state,
            "who": f"{entry.who} ({entry.where})",
            "what": ": ".join(filter(None, (entry.note, steps))),
            "may": self._watch.may("configure"),
        }


async def _schema() -> dict[str, Any]:
    """Return the schema of configurations; the editor's validator knows the draft by itself."""
    known = await asyncio.to_thread(_built)
    return {key: value for key, value in known.items() if key != "$schema"}


@cache
def _built() -> dict[str, Any]:
    return schema.build()


def _plan_text(plan: PlanAnswer) -> str:
    lines = [_step_text(step) for step in plan.steps] or ["nothing changes"]
    if plan.restart:
        lines.append(f"everything is interrupted for about a second, because of {', '.join(plan.restart)}")
    return "\n".join([*lines, f"{plan.unchanged_routes} routes go on as they are"])


def _step_text(step: StepRow) -> str:
    details = f" ({'; '.join(step.details)})" if step.details else ""
    interrupts = f"; interrupts {step.interrupts}" if step.interrupts else ""
    return f"{step.action} {step.what} {step.name}{details}{interrupts}"
