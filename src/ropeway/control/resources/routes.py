"""Single routes of the configuration that runs: list, add, remove, pause and resume them."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from ropeway.control.edits import Edit, add_route, remove_route, set_active
from ropeway.control.resource import Audited, ControlRequest, Resources
from ropeway.control.resources.config import AppliedModel, note_applied

__all__ = ["resources"]

resources = Resources()


class RouteBody(BaseModel):
    """A route to add. A remote that is not there yet is made, with its address alone."""

    model_config = ConfigDict(extra="forbid")

    remote: str = Field(description="the address, the title or the number of a remote", max_length=1000)
    operation: str = Field(description="publish, subscribe, trans-publish, expose-service, …", max_length=40)
    item: dict[str, Any] = Field(description="as it stands in a file: name, type, and options")


@resources.get("/v1/routes", right="observe")
async def list_routes(asked: ControlRequest) -> Any:
    """Return how every route is, each with its key."""
    return asked.manager.status()["routes"]


@resources.post("/v1/routes", right="configure", takes=RouteBody, gives=AppliedModel, audited=Audited("route add"))
async def add(asked: ControlRequest) -> Any:
    """Add a route; everything else goes on."""
    body: RouteBody = asked.body
    asked.noted["name"] = f"{body.operation} {body.item.get('name', '')} {body.remote}"
    return await _edited(asked, add_route(body.remote, body.operation, body.item), "route add")


@resources.delete("/v1/routes/{key}", right="configure", gives=AppliedModel, audited=Audited("route rm", "key"))
async def remove(asked: ControlRequest) -> Any:
    """Remove a route."""
    return await _edited(asked, remove_route(asked.path["key"]), "route rm")


@resources.post("/v1/routes/{key}/pause", right="configure", gives=AppliedModel, audited=Audited("route pause", "key"))
async def pause(asked: ControlRequest) -> Any:
    """Pause a route: it stays in the configuration, and nothing crosses."""
    return await _edited(asked, set_active(asked.path["key"], active=False), "route pause")


@resources.post(
    "/v1/routes/{key}/resume", right="configure", gives=AppliedModel, audited=Audited("route resume", "key")
)
async def resume(asked: ControlRequest) -> Any:
    """Let a paused route go on."""
    return await _edited(asked, set_active(asked.path["key"], active=True), "route resume")


async def _edited(asked: ControlRequest, edit: Edit, action: str) -> Any:
    key = asked.path.get("key")
    routes = (*asked.manager.config.routes(), *asked.manager.config.routes(active=False))
    named = next((route for route in routes if route.key == key), None)
    if named is not None:  # a key says nothing to people
        asked.noted["name"] = f"{named.operation} {named.name} {named.remote.address}"
    done = await asked.manager.edit(edit, asked.caller, action=action, if_match=asked.headers.get("if-match"))
    return note_applied(asked, done)
