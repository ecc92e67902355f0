"""Asks the groups of a gateway, wherever it runs: see ``questions``."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

from ropeway.errors import RopewayError
from ropeway.gateway.group import GroupRemote
from ropeway.gateway.group_commands import GroupCommands
from ropeway.tasks import describe

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway

__all__ = ["command_group", "list_groups"]


async def list_groups(gateway: Gateway, params: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the profiles of all groups of a gateway."""
    return [remote.commands.report() for remote in _groups(gateway)]


async def command_group(gateway: Gateway, params: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Carry out a command on the groups that ``params`` means; a fault is an answer with ``error``."""
    wanted, answers = params.get("group", ""), []
    for remote in _groups(gateway):
        if wanted in ("", remote.graph.name):
            try:
                answers.append(await _command(remote.commands, params))
            except RopewayError as error:
                answers.append({"group": remote.graph.name, "error": describe(error)})
    return answers


def _groups(gateway: Gateway) -> list[GroupRemote]:
    return [remote for remote in gateway.remotes if isinstance(remote, GroupRemote)]


async def _command(commands: GroupCommands, params: Mapping[str, Any]) -> dict[str, Any]:
    if params["command"] == "profile":
        return await commands.optimise()
    if params["command"] == "switch":
        return commands.switch(params["member"])
    return commands.pause(params["paused"])
