"""The clients of a gateway, what they read and send; and the button that disconnects one."""

from __future__ import annotations

import time
from typing import Any, Final

from ropeway.control.async_client import path_of
from ropeway.control.figures import duration, shown_number
from ropeway.dashboard.answers import SessionRow
from ropeway.dashboard.frame import Page
from ropeway.dashboard.tables import fill, make_table
from ropeway.dashboard.watch import GatewayWatch

__all__ = ["make"]

_COLUMNS: Final = {
    "peer": "client",
    "kind": "kind",
    "role": "role",
    "for": "for",
    "in": "in MB",
    "out": "out MB",
    "denied": "denied",
    "topics": "topics",
    "more": "",
}
_KICK: Final = """<q-btn flat dense no-caps color="negative" label="disconnect"
:disable="!props.row.may" :title="props.row.may ? '' : 'your role lacks the right operate'"
@click="() => $parent.$emit('kick', props.row.peer)"/>"""
_CARD: Final = f"""<div class="q-pa-xs col-12"><q-card flat bordered class="q-pa-sm">
<div class="row items-center"><div class="text-weight-medium wraps">
{{{{ props.row.peer }}}} {{{{ props.row.kind }}}}</div><q-space/>{_KICK}</div>
<div class="text-caption wraps">role {{{{ props.row.role }}}}, for {{{{ props.row.for }}}},
in {{{{ props.row.in }}}} MB, out {{{{ props.row.out }}}} MB, {{{{ props.row.denied }}}} denied</div>
<div class="text-caption wraps">{{{{ props.row.topics }}}}</div></q-card></div>"""


def make(page: Page) -> None:
    """Make the page."""
    watch = page.watch
    if watch is None:
        return
    table = make_table(
        _COLUMNS,
        "Nobody is connected.",
        slots={"body-cell-more": f'<q-td :props="props" style="white-space: nowrap">{_KICK}</q-td>', "item": _CARD},
        wide=("in", "out", "role"),
    )

    def update() -> None:
        sessions = watch.status.sessions if watch.status is not None else []
        fill(table, [_row(watch, session) for session in sessions])

    async def kick(event: Any) -> None:
        peer = str(event.args)
        await page.do(lambda: watch.client.delete(path_of("sessions", peer)), f"{peer} was disconnected")

    table.on("kick", kick)
    page.every(update)


def _row(watch: GatewayWatch, session: SessionRow) -> dict[str, Any]:
    kind = f"gateway {session.gateway}" if session.gateway else f"{session.dialect} {session.agent}"
    topics = [
        f"{'→' if topic.direction == 'out' else '←'} {topic.name} {shown_number(topic.rate_hz)} Hz"
        for topic in session.topics
    ]
    return {
        "id": session.peer,
        "peer": session.peer,
        "kind": kind,
        "role": session.role,
        "for": duration(time.time() - session.since),
        "in": shown_number(session.bytes_in, 1e-6),
        "out": shown_number(session.bytes_out, 1e-6),
        "denied": f"{sum(session.denied.values()):.0f}",
        "topics": ", ".join(topics[:20]) + (f" and {len(topics) - 20} more" if len(topics) > 20 else ""),
        "may": watch.may("operate"),
    }
