"""Tells callers who they are, and what they may do."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel

from ropeway.control.resource import ControlRequest, Resources

__all__ = ["resources"]

resources = Resources()


class CallerModel(BaseModel):
    """The name of the caller, the rights at the control API, and the gateway that says so."""

    name: str
    rights: list[str]
    gateway: str


@resources.get("/v1/caller", gives=CallerModel)
async def read_caller(asked: ControlRequest) -> Any:
    """Return who asks, with which rights, so that a program offers only what is allowed."""
    caller = asked.caller
    return CallerModel(name=caller.name, rights=sorted(caller.rights), gateway=asked.manager.config.gateway.name)
