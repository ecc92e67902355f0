"""Drives a robot with a joystick: publishes a Twist ten times a second while it is held, and zero when it is let go.

Three things stop the robot: letting go; this process, when it hears nothing more of the browser that holds the
joystick; and the lease at the robot's gateway (``safety``), when it hears nothing more of this process.
"""

from __future__ import annotations

import math
import secrets
import time
from pathlib import Path
from typing import Any, Final

from nicegui import ui

from ropeway.dashboard.answers import TopicRow, read
from ropeway.dashboard.frame import Page
from ropeway.dashboard.watch import GatewayWatch
from ropeway.errors import RopewayError
from ropeway.tasks import describe

__all__ = ["make"]

_TWIST: Final = "geometry_msgs/msg/Twist"
_STAMPED: Final = "geometry_msgs/msg/TwistStamped"
_SILENT_S: Final = 0.5
_SCRIPT: Final = (Path(__file__).parent.parent / "joystick.js").read_text()
_PAD: Final = """<div class="joystick" style="width:260px;height:260px;max-width:80vw;max-height:80vw;border-radius:50%;
background:#94a3b844;position:relative;touch-action:none;margin:auto"><div class="knob" style="width:34%;height:34%;
border-radius:50%;background:#1d4ed8;position:absolute;left:33%;top:33%;pointer-events:none"></div></div>"""


def make(page: Page) -> None:
    """Make the page."""
    if page.watch is None:
        return
    _Driving(page, page.watch)


class _Driving:
    """The joystick of one page."""

    def __init__(self, page: Page, watch: GatewayWatch) -> None:
        self._page, self._watch = page, watch
        self._driver = secrets.token_hex(4)
        self._held_at = 0.0
        self._busy = False
        self._next: tuple[float, float] | None = None
        topics = {"/cmd_vel": _TWIST}
        with ui.row().classes("full-width items-center"):
            self._topic = ui.input("Topic", value="/cmd_vel").props("dense")
            self._type = ui.select([_TWIST, _STAMPED], value=topics["/cmd_vel"], label="Type").props("dense")
        self._linear = _slider("Fastest, m/s", 2.0, 0.3)
        self._angular = _slider("Fastest turn, rad/s", 3.0, 0.8)
        self._said = ui.label().classes("text-center full-width wraps").mark("driving")
        if watch.may("operate"):
            ui.html(_PAD, sanitize=False).classes("full-width").mark("joystick")
            ui.run_javascript(_SCRIPT)
            ui.on("drive", self._driven)
        else:
            ui.label(f'{watch.caller.name or "This login"} lacks the right "operate", so it cannot drive.')
        self._guard = ui.label().classes("wraps text-caption")
        page.every(self._show_guard)
        page.every(self._suggest)
        ui.timer(_SILENT_S / 2, self._stop_if_silent)

    async def _driven(self, event: Any) -> None:
        """Take the position of the joystick, which the browser tells ten times a second while it is held."""
        args = event.args if isinstance(event.args, dict) else {}
        if not args.get("held"):
            await self._stop()
            return
        self._held_at = time.monotonic()
        await self._send(_share(args.get("y")) * self._linear.value, -_share(args.get("x")) * self._angular.value)

    async def _stop_if_silent(self) -> None:
        if self._held_at and time.monotonic() - self._held_at > _SILENT_S:
            await self._stop()

    async def _stop(self) -> None:
        self._held_at = 0.0
        await self._send(0.0, 0.0)

    async def _send(self, linear: float, angular: float) -> None:
        """Publish a command; while one is under way, only the newest waits."""
        self._next = (linear, angular)
        if self._busy or self._watch.error or not self._page.viewer.active:
            return
        self._busy = True
        try:
            while self._next is not None:
                now, self._next = self._next, None
                await self._publish(*now)
        finally:
            self._busy = False

    async def _publish(self, linear: float, angular: float) -> None:
        twist = {"linear": {"x": linear}, "angular": {"z": angular}}
        type = str(self._type.value)
        body = {
            "name": self._topic.value,
            "type": type,
            "message": {"twist": twist} if type == _STAMPED else twist,
            "driver": self._driver,
        }
        try:
            done = await self._watch.client.post("/v1/topics/publish", body)
        except RopewayError as error:
            self._said.set_text(describe(error))
            self._next = None
            return
        readers = done.get("readers") if isinstance(done, dict) else None
        heard = "nobody reads it" if readers == 0 else f"{'?' if readers is None else readers} readers"
        self._said.set_text(f"{linear:.2f} m/s, {angular:.2f} rad/s: {heard}")

    async def _suggest(self) -> None:
        """Take the first topic of commands that the gateway knows, once."""
        self._page.updates.remove(self._suggest)
        try:
            topics = read(list[TopicRow], await self._watch.client.get("/v1/topics"))
        except RopewayError:
            return
        found = next((topic for topic in topics if topic.type in (_TWIST, _STAMPED)), None)
        if found is not None and self._topic.value == "/cmd_vel":
            self._topic.set_value(found.name)
            self._type.set_value(found.type)

    def _show_guard(self) -> None:
        """Say whether a lease guards the topic at a gateway that is watched."""
        lines = []
        for watch in self._page.watches:
            for guard in watch.status.safety if watch.status is not None else ():
                if guard.get("topic") == self._topic.value:
                    driver = guard.get("driver") or "nobody"
                    lines.append(f"{watch.name} guards this topic: {driver} drives, {guard.get('clamped', 0)} cut")
        self._guard.set_text(
            "\n".join(lines)
            or "No gateway that is shown here guards this topic. If the link breaks while you drive, nothing stops the "
            "robot: give the topic a lease with gateway.safety at the robot."
        )


def _slider(label: str, most: float, value: float) -> ui.slider:
    with ui.row().classes("full-width items-center no-wrap"):
        ui.label(label).style("min-width: 130px")
        return ui.slider(min=0.0, max=most, step=0.05, value=value).props("label label-always switch-label-side")


def _share(value: Any) -> float:
    """Return how far the joystick is moved, between -1 and 1; what is no number does not move it."""
    number = float(value) if isinstance(value, int | float) and math.isfinite(value) else 0.0
    return min(max(number, -1.0), 1.0)
