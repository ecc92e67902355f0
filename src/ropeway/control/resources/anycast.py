"""The groups of the gateway: their profiles, and what may be done to them by hand."""

from __future__ import annotations

from typing import Any, Final

from pydantic import Field

from ropeway.control.resource import Audited, ControlRequest, Resources
from ropeway.errors import ControlRefused
from ropeway.gateway.config.fields import Model
from ropeway.loading import load

__all__ = ["resources"]

resources = Resources()

_QUESTIONS: Final = "ropeway.gateway.process.group_questions"
"""The module that is loaded once somebody asks for groups, as most gateways have none."""


class GroupRequest(Model):
    """Names a group; the only one needs no name."""

    group: str = Field("", description="the title of the group, or its addresses with commas between")


class SwitchRequest(GroupRequest):
    """Names a group and a member of it."""

    member: str = Field(description="its address, or its name in initial_policy")


class PauseRequest(GroupRequest):
    """Names a group, and says whether its scheduler pauses."""

    paused: bool = Field(True, description="true: nothing is changed until the member in use is gone")


@resources.get("/v1/anycast", gives=list[dict[str, Any]])
async def list_profiles(asked: ControlRequest) -> Any:
    """Return the profiles of all groups."""
    questions = await load(_QUESTIONS)
    return [group for answer in await asked.manager.ask(questions.list_groups, {}) for group in answer]


@resources.post(
    "/v1/anycast/profile", right="operate", takes=GroupRequest, gives=dict[str, Any], audited=Audited("anycast profile")
)
async def profile(asked: ControlRequest) -> Any:
    """Ask each member of a group for a moment, use the best, and return the profile."""
    return await _command(asked, "profile")


@resources.post(
    "/v1/anycast/switch", right="operate", takes=SwitchRequest, gives=dict[str, Any], audited=Audited("anycast switch")
)
async def switch(asked: ControlRequest) -> Any:
    """Use a member of a group from the next request on, and return the profile."""
    return await _command(asked, "switch")


@resources.post(
    "/v1/anycast/pause", right="operate", takes=PauseRequest, gives=dict[str, Any], audited=Audited("anycast pause")
)
async def pause(asked: ControlRequest) -> Any:
    """Have the scheduler of a group keep the member in use, or choose again, and return the profile."""
    return await _command(asked, "pause")


async def _command(asked: ControlRequest, command: str) -> Any:
    questions = await load(_QUESTIONS)
    known = [group["group"] for group in await list_profiles(asked)]
    params = {**asked.body.model_dump(), "command": command}
    asked.noted.update(name=params["group"], **{key: params[key] for key in ("member", "paused") if key in params})
    wanted = params["group"]
    if wanted and wanted not in known:
        raise ControlRefused(404, f'no group is called "{wanted}"; there are: {", ".join(known) or "none"}')
    if not wanted and len(known) != 1:
        raise ControlRefused(409, f"name the group: {', '.join(known)}" if known else "this gateway has no group")
    answers = [found for answer in await asked.manager.ask(questions.command_group, params) for found in answer]
    if not answers:
        raise ControlRefused(404, f'the group "{wanted}" is gone')
    if "error" in answers[0]:
        raise ControlRefused(409, answers[0]["error"])
    return answers[0]
