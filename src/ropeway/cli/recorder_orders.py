"""Asks a running gateway for its recorders: how they are, and to start, to stop or to write a clip."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.credentials import graph_credentials

if TYPE_CHECKING:
    from ropeway.control.client import ControlClient

__all__ = ["RecorderOrder", "carry_out"]


@dataclass(frozen=True)
class RecorderOrder:
    """An order to recorders of a gateway; without any, they are shown. ``recorder`` is one of them, ``""`` for all."""

    where: str | None = None
    recorder: str = ""
    trigger: bool = False
    why: str = ""
    start: bool = False
    stop: bool = False

    @property
    def given(self) -> bool:
        """Whether a gateway is meant, and no recording of our own."""
        return self.where is not None or self.trigger or self.start or self.stop


def carry_out(order: RecorderOrder, *, as_json: bool) -> None:
    """Carry an order out, and show what comes of it."""
    if order.trigger + order.start + order.stop > 1:
        fail("give one order: --trigger, --start or --stop", 2)
    from ropeway.control.client import ControlClient

    shown = graph_credentials()
    with ControlClient.find(order.where, token=shown.token, ca=shown.ca, cert=shown.certificate) as client:
        if order.trigger:
            found = client.post("/v1/recordings/trigger", {"name": order.recorder, "why": order.why})
            if as_json:
                print_json(found)
            else:
                answer(f"a clip is written by {', '.join(found['triggered'])}")
        elif order.start or order.stop:
            client.post(f"/v1/recordings/{'start' if order.start else 'stop'}", {"name": order.recorder})
            _show(client, order.recorder, as_json=as_json)
        else:
            _show(client, order.recorder, as_json=as_json)


def _show(client: ControlClient, name: str, *, as_json: bool) -> None:
    rows: list[dict[str, Any]] = [row for row in client.get("/v1/recordings") if name in ("", row["name"])]
    if as_json:
        print_json(rows)
        return
    if not rows:
        fail(
            f"no recorder is called {name}" if name else "this gateway has no recorder; write one under gateway.record"
        )
    from ropeway.cli.fitting_table import print_table
    from ropeway.cli.status.tables import recording_table

    print_table(recording_table(rows))
    for row in rows:
        for file in row["files"]:
            answer(f"{file['path']}  {file['bytes'] / 1e6:.1f} MB")
