"""The configuration that runs: read it, plan a change, apply it, go back; and the history of changes."""

from __future__ import annotations

from typing import Any, Final

from pydantic import BaseModel, ConfigDict, Field

from ropeway.control.manager import Applied
from ropeway.control.resource import Answer, Audited, ControlRequest, Resources
from ropeway.errors import ControlRefused
from ropeway.gateway.plan import ConfigPlan

__all__ = ["note_applied", "resources"]

resources = Resources()

_MOST_ENTRIES: Final = 1_000
_MOST_STEPS: Final = 50  # in the audit log; the journal has all


class ConfigBody(BaseModel):
    """A configuration in any spelling. Relative paths in it start at ``directory``."""

    model_config = ConfigDict(extra="forbid")

    config: Any = Field(description="as a file has it: the full form, a list of remotes, or one remote")
    directory: str = Field(".", max_length=4096, description="where its relative paths start")
    note: str = Field("", max_length=1000, description="for the history")


class RollbackBody(BaseModel):
    """The entry of the history to go back to; left out: the last that ran with another configuration."""

    model_config = ConfigDict(extra="forbid")

    number: int | None = Field(None, ge=1, lt=1 << 62)


class StepModel(BaseModel):
    """A step of a plan."""

    action: str
    what: str
    name: str
    path: str
    details: list[str]
    interrupts: str


class PlanModel(BaseModel):
    """The steps of a change; ``restart`` names keys that interrupt everything."""

    steps: list[StepModel]
    unchanged_routes: int
    restart: list[str]


class AppliedModel(PlanModel):
    """A change that was applied, with its number in the history."""

    applied: bool
    number: int


@resources.get("/v1/config", right="configure")
async def read_config(asked: ControlRequest) -> Answer:
    """Return the configuration that runs, in the full form; its ETag is for ``If-Match``."""
    config = asked.manager.config
    body = {"etag": config.etag, "source": config.source, "config": config.to_json()}
    return Answer(body, headers={"etag": f'"{config.etag}"'})


@resources.put("/v1/config", right="configure", takes=ConfigBody, gives=AppliedModel, audited=Audited("apply"))
async def apply_config(asked: ControlRequest) -> Answer:
    """Apply a configuration: all of it or nothing. With ``If-Match``, 409 tells what was changed meanwhile."""
    body: ConfigBody = asked.body
    config = await asked.manager.read(body.config, body.directory)
    done = await asked.manager.apply(config, asked.caller, note=body.note, if_match=asked.headers.get("if-match"))
    note_applied(asked, done)
    return Answer(done, headers={"etag": f'"{config.etag}"'})


@resources.post("/v1/config/plan", right="configure", takes=ConfigBody, gives=PlanModel, audited=Audited("plan"))
async def plan_config(asked: ControlRequest) -> Answer:
    """Return what a configuration would start, stop and change, and what that interrupts. Nothing is done."""
    body: ConfigBody = asked.body
    plan = await asked.manager.plan(await asked.manager.read(body.config, body.directory))
    _note_plan(asked, plan)
    return Answer(plan, headers={"etag": f'"{asked.manager.config.etag}"'})


@resources.post(
    "/v1/config/rollback", right="configure", takes=RollbackBody, gives=AppliedModel, audited=Audited("rollback")
)
async def roll_back(asked: ControlRequest) -> Any:
    """Go back to a configuration that has run."""
    body: RollbackBody = asked.body
    done = await asked.manager.rollback(asked.caller, body.number, if_match=asked.headers.get("if-match"))
    return note_applied(asked, done)


@resources.get("/v1/config/history", right="observe")
async def list_history(asked: ControlRequest) -> Any:
    """Return the last changes, the newest first: ``?count=20``, ``?before=NUMBER``."""
    count = _number(asked.query.get("count", "20"), "count")
    before = _number(asked.query["before"], "before") if "before" in asked.query else None
    entries = await asked.manager.record.history(min(count, _MOST_ENTRIES), before)
    return [entry.to_json() for entry in entries]


@resources.get("/v1/config/history/{number}", right="configure")
async def read_history(asked: ControlRequest) -> Any:
    """Return a change with its configuration."""
    entry = await asked.manager.record.entry(_number(asked.path["number"], "number"))
    return {**entry.to_json(), "config": await asked.manager.record.config(entry)}


def note_applied(asked: ControlRequest, done: Applied) -> Applied:
    """Add what was done to the entry of the audit log; return it."""
    asked.noted["number"] = done.number
    _note_plan(asked, done.plan)
    return done


def _note_plan(asked: ControlRequest, plan: ConfigPlan) -> None:
    steps = [f"{step.action} {step.what} {step.name}" for step in plan.steps]
    asked.noted.update(etag=plan.new.etag, steps=steps[:_MOST_STEPS], step_count=len(steps))


def _number(text: str, what: str) -> int:
    if not (text.isascii() and text.isdigit() and len(text) < 18):
        raise ControlRefused(422, f"{what}: expected a number, got {text[:20]}")
    return int(text)
