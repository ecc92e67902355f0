"""Parameters of a ROS 1 network, as rosapi has them: those of its master, named ``/robot/speed``, as JSON texts."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from ropeway import aio
from ropeway.errors import RopewayError
from ropeway.graph.parameter_server import ParameterServer
from ropeway.listener.globs import Globs
from ropeway.networks.rosbridge.rosapi.params import from_json, to_json
from ropeway.types.untrusted import json_value

__all__ = ["MasterParams"]


class MasterParams:
    """Answers like ``Params``, for a graph with a parameter server. ``timeout_s`` bounds every call."""

    def __init__(self, server: ParameterServer, globs: Globs, timeout_s: float) -> None:
        self._server, self._globs, self._timeout_s = server, globs, timeout_s

    async def get(self, name: str, default: str) -> dict[str, Any]:
        """Return the value of a parameter, or ``default`` with the reason."""
        value, reason = await self._tried(name, lambda: self._server.get_param(_absolute(name)))
        if reason:
            return {"value": to_json(from_json(default)), "successful": False, "reason": reason}
        return {"value": to_json(value), "successful": True, "reason": ""}

    async def has(self, name: str) -> bool:
        """Return whether the parameter exists."""
        return not (await self._tried(name, lambda: self._server.get_param(_absolute(name))))[1]

    async def set(self, name: str, value: str) -> dict[str, Any]:
        """Set a parameter to a JSON text."""
        try:
            given = json_value(value)
        except ValueError as error:
            reason = f"the value of a parameter is a JSON text, which {value!r:.100} is not: {error}"
            return {"successful": False, "reason": reason}
        _, reason = await self._tried(name, lambda: self._server.set_param(_absolute(name), given))
        return {"successful": not reason, "reason": reason}

    async def delete(self, name: str) -> dict[str, Any]:
        """Delete a parameter; one that is not there needs no deleting."""
        if not await self.has(name) and Globs.allows(_absolute(name), self._globs.params):
            return {"successful": True, "reason": ""}
        _, reason = await self._tried(name, lambda: self._server.delete_param(_absolute(name)))
        return {"successful": not reason, "reason": reason}

    async def names(self) -> list[str]:
        """Return the names of all parameters that the globs show."""
        try:
            async with aio.timeout(self._timeout_s):
                found = await self._server.list_params()
        except (RopewayError, TimeoutError):
            return []
        return [name for name in found if Globs.allows(name, self._globs.params)]

    async def _tried(self, name: str, work: Callable[[], Any]) -> tuple[Any, str]:
        """Return the result, or the reason for failure."""
        if not Globs.allows(_absolute(name), self._globs.params):
            return None, f"Parameter {name} does not match any of the glob strings"
        try:
            async with aio.timeout(self._timeout_s):
                return await work(), ""
        except KeyError:
            return None, f"Parameter {name} not found"
        except TimeoutError:
            return None, "Timeout occurred"
        except (RopewayError, ValueError) as error:
            return None, str(error)


def _absolute(name: str) -> str:
    return name if name.startswith("/") else f"/{name}"
