"""The recorders of the gateway: how they are, their files, and orders to them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from pydantic import Field

from ropeway.control.resource import Audited, ControlRequest, Resources
from ropeway.errors import ControlRefused
from ropeway.gateway.config.fields import Model
from ropeway.gateway.process.recording_questions import (
    list_recordings,
    start_recording,
    stop_recording,
    trigger_recording,
)

if TYPE_CHECKING:
    from ropeway.gateway.process.questions import Question

__all__ = ["resources"]

resources = Resources()


class RecorderRequest(Model):
    """Names a recorder."""

    name: str = Field("", description="the name of the recorder; all of them without")


class TriggerRequest(RecorderRequest):
    """Names a recorder, and says what has happened."""

    why: str = Field("", max_length=1000, description="what has happened, for who looks at the clip")


@resources.get("/v1/recordings", gives=list[dict[str, Any]])
async def recordings(asked: ControlRequest) -> Any:
    """Return the recorders of the gateway, of each of its workers, with their states and files."""
    return [row for answer in await asked.manager.ask(list_recordings, {}) for row in answer]


@resources.post(
    "/v1/recordings/start",
    right="operate",
    takes=RecorderRequest,
    gives=list[dict[str, Any]],
    audited=Audited("recording start"),
)
async def start_recorder(asked: ControlRequest) -> Any:
    """Start a recorder; it goes on until it is stopped, or the gateway ends."""
    return await _order(asked, start_recording, "started")


@resources.post(
    "/v1/recordings/stop",
    right="operate",
    takes=RecorderRequest,
    gives=list[dict[str, Any]],
    audited=Audited("recording stop"),
)
async def stop_recorder(asked: ControlRequest) -> Any:
    """Stop a recorder; what it was writing is whole."""
    return await _order(asked, stop_recording, "stopped")


@resources.post(
    "/v1/recordings/trigger",
    right="operate",
    takes=TriggerRequest,
    gives=dict[str, list[str]],
    audited=Audited("recording trigger"),
)
async def trigger_clip(asked: ControlRequest) -> Any:
    """Have recorders with a ring write a clip of what was and of what comes; return their names."""
    name = _named(asked)
    why = asked.body.why or f"asked by {asked.caller.name}"
    asked.noted["why"] = why
    answers = await asked.manager.ask(trigger_recording, {"name": name, "why": why})
    triggered = sorted({one for answer in answers for one in answer})
    if not triggered:
        text = "it has no ring" if name else "no recorder has a ring"
        raise ControlRefused(409, f"{text} that is running; give it ring_s, or start it (ropeway record --start)")
    for one in triggered:
        asked.manager.events.tell("recording", one, state="triggered", before="", why=why)
    return {"triggered": triggered}


def _named(asked: ControlRequest) -> str:
    """Return the name that was asked for. Raises ``ControlRefused`` where no recorder has it."""
    name: str = asked.body.name
    known = [one.name for one in asked.manager.config.gateway.record]
    asked.noted["name"] = name
    if not known:
        raise ControlRefused(404, "this gateway has no recorder; write one under gateway.record")
    if name and name not in known:
        raise ControlRefused(404, f'no recorder is called "{name}"; there are: {", ".join(known)}')
    return name


async def _order(asked: ControlRequest, question: Question, state: str) -> Any:
    name = _named(asked)
    rows = [row for answer in await asked.manager.ask(question, {"name": name}) for row in answer]
    wanted = [row for row in rows if name in ("", row["name"])]
    for one in dict.fromkeys(row["name"] for row in wanted):
        asked.manager.events.tell("recording", one, state=state, before="", why=f"asked by {asked.caller.name}")
    return wanted
