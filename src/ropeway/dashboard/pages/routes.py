"""The routes of a gateway: state, rate with its last minutes, readers, drops; and why one crosses or does not."""

from __future__ import annotations

from typing import Any, Final

from ropeway.control.async_client import path_of
from ropeway.control.figures import shown_number
from ropeway.dashboard.answers import ExplanationRow, RouteRow
from ropeway.dashboard.explanation import show_explanation
from ropeway.dashboard.frame import Page
from ropeway.dashboard.svg import colour_of, points
from ropeway.dashboard.tables import STATE_CELL, fill, make_table
from ropeway.dashboard.watch import GatewayWatch

__all__ = ["make"]

_SPARK_WIDTH: Final = 100
_SPARK_HEIGHT: Final = 22
_COLUMNS: Final = {
    "name": "name",
    "state": "state",
    "spark": "last two minutes",
    "rate": "Hz",
    "delay": "ms",
    "bandwidth": "Mbit/s",
    "ends": "from → to",
    "drops": "drops",
    "encoding": "encoding",
    "why": "why",
    "more": "",
}
_SPARK_CELL: Final = f"""<q-td :props="props"><svg width="{_SPARK_WIDTH}" height="{_SPARK_HEIGHT + 2}">
<polyline :points="props.row.spark" fill="none" :stroke="props.row.colour" stroke-width="1.5"/></svg></q-td>"""
_MORE_CELL: Final = """<q-td :props="props" style="white-space: nowrap">
<q-btn flat dense no-caps color="primary" label="why?"
@click="() => $parent.$emit('explain', props.row.id)"/><q-btn flat dense no-caps color="primary"
:label="props.row.paused ? 'resume' : 'pause'" :disable="!props.row.may"
:title="props.row.may ? '' : 'your role lacks the right configure'"
@click="() => $parent.$emit('switch', props.row.id)"/></q-td>"""
_CARD: Final = f"""<div class="q-pa-xs col-12"><q-card flat bordered class="q-pa-sm">
<div class="row items-center no-wrap"><div class="text-weight-medium wraps">{{{{ props.row.name }}}}</div><q-space/>
<q-badge :style="'background:' + props.row.colour">{{{{ props.row.state }}}}</q-badge></div>
<div class="row items-center figures"><svg width="{_SPARK_WIDTH}" height="{_SPARK_HEIGHT + 2}"><polyline
:points="props.row.spark" fill="none" :stroke="props.row.colour" stroke-width="1.5"/></svg>
<span class="q-ml-sm">{{{{ props.row.rate }}}} Hz, {{{{ props.row.delay }}}} ms, {{{{ props.row.bandwidth }}}} Mbit/s,
{{{{ props.row.drops }}}} drops</span></div><div class="text-caption wraps">{{{{ props.row.operation }}}}
{{{{ props.row.ends }}}} {{{{ props.row.encoding }}}} {{{{ props.row.why }}}}</div>
<q-btn flat dense no-caps color="primary" label="why?" @click="() => $parent.$emit('explain', props.row.id)"/>
<q-btn flat dense no-caps color="primary" :label="props.row.paused ? 'resume' : 'pause'" :disable="!props.row.may"
@click="() => $parent.$emit('switch', props.row.id)"/></q-card></div>"""


def make(page: Page) -> None:
    """Make the page."""
    watch = page.watch
    if watch is None:
        return
    table = make_table(
        _COLUMNS,
        "No route is configured.",
        slots={
            "body-cell-state": STATE_CELL,
            "body-cell-spark": _SPARK_CELL,
            "body-cell-more": _MORE_CELL,
            "item": _CARD,
        },
        wide=("ends", "encoding", "bandwidth"),
    )
    by_id: dict[str, RouteRow] = {}

    def update() -> None:
        routes = watch.status.routes if watch.status is not None else []
        by_id.clear()
        by_id.update({_id(route, number): route for number, route in enumerate(routes)})
        fill(table, [_row(watch, identity, route) for identity, route in by_id.items()])

    async def explain(event: Any) -> None:
        route = by_id.get(str(event.args))
        if route is not None:
            found = await page.fetch(list[ExplanationRow], "/v1/explain", name=route.name, to=route.address)
            if found is not None:
                show_explanation(found)

    async def switch(event: Any) -> None:
        route = by_id.get(str(event.args))
        if route is not None:
            word = "resume" if route.state == "paused" else "pause"
            path = path_of("routes", route.key, word)
            await page.do(lambda: watch.client.post(path), f"{route.name}: {word}d")

    table.on("explain", explain)
    table.on("switch", switch)
    page.every(update)


def _id(route: RouteRow, number: int) -> str:
    return route.key or str(number)


def _count(number: int | None) -> str:
    return "?" if number is None else str(number)


def _row(watch: GatewayWatch, identity: str, route: RouteRow) -> dict[str, Any]:
    return {
        "id": identity,
        "name": route.name,
        "operation": route.operation,
        "state": route.state,
        "colour": colour_of(route.state),
        "spark": points(watch.rates.of(route.key), _SPARK_WIDTH, _SPARK_HEIGHT),
        "rate": shown_number(route.rate_hz),
        "delay": shown_number(route.delay_ms if route.delay_ms is not None else route.took_ms),
        "bandwidth": shown_number(route.bandwidth_bps, 1e-6),
        "ends": f"{_count(route.publishers)} → {_count(route.readers)}",
        "drops": f"{sum(route.drops.values()):.0f}",
        "encoding": route.encoding,
        "why": route.why,
        "paused": route.state == "paused",
        "may": watch.may("configure"),
    }
