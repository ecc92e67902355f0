"""The master's API: registrations, look-ups and the parameter server."""

from __future__ import annotations

import os
from typing import Any, Final
from urllib.parse import urlsplit

from ropeway.errors import ConnectFailed, GraphUnavailable
from ropeway.networks.ros1.xmlrpc import Fault, XmlRpcClient

__all__ = ["DEFAULT_URI", "Master", "MasterRefused", "master_uri", "slave_call"]

DEFAULT_URI: Final = "http://127.0.0.1:11311"
_DEFAULT_PORT: Final = 11311
_CALL_S: Final = 5.0
_LEAVE_S: Final = 1.0  # taking leave of a master that does not answer must not hold up closing


class MasterRefused(Exception):
    """The master, or a node, answered that it did not do it; the text says why."""


def master_uri(text: str = "") -> str:
    """Return ``http://host:port`` from a URI, ``host:port``, or (left out) ``ROS_MASTER_URI``.

    Raises ``GraphUnavailable`` for what is none.
    """
    given = text or os.environ.get("ROS_MASTER_URI", "") or DEFAULT_URI
    try:
        parts = urlsplit(given if "//" in given else f"http://{given}")
        host, port = parts.hostname, parts.port or _DEFAULT_PORT
    except ValueError:
        host, port, parts = None, 0, urlsplit("")
    if not host or parts.scheme != "http" or parts.path not in ("", "/") or parts.query:
        raise GraphUnavailable(f"ros1:{given}", "is not the address of a ROS 1 master; write ros1:http://host:11311")
    return f"http://{f'[{host}]' if ':' in host else host}:{port}"


async def slave_call(client: XmlRpcClient, uri: str, method: str, *params: Any, timeout_s: float = _CALL_S) -> Any:
    """Call the master's or a node's API and return the value.

    Raises ``MasterRefused`` where its code is not that of success, ``ConnectFailed`` where nobody answers properly,
    ``ValueError`` for parameters that XML-RPC cannot write.
    """
    try:
        answer = await client.call(uri, method, *params, timeout_s=timeout_s)
    except Fault as fault:
        raise MasterRefused(f"{method}: {fault.faultString}") from None
    if not isinstance(answer, (list, tuple)) or len(answer) != 3:
        raise ConnectFailed(uri, f"the answer to {method} is not [code, text, value]")
    if answer[0] != 1:
        raise MasterRefused(f"{method}: {answer[1]}")
    return answer[2]


class Master:
    """A master, as the node ``caller`` uses it. Errors of all methods are those of ``slave_call``."""

    def __init__(self, uri: str, client: XmlRpcClient, caller: str) -> None:
        self.uri = uri
        self.caller = caller
        self._client = client
        self._answers = True

    async def call(self, method: str, *params: Any, timeout_s: float = _CALL_S) -> Any:
        """Call with our name in front."""
        try:
            answer = await slave_call(self._client, self.uri, method, self.caller, *params, timeout_s=timeout_s)
        except ConnectFailed:
            self._answers = False
            raise
        self._answers = True
        return answer

    async def leave(self, method: str, *params: Any) -> None:
        """Withdraw a registration, unless the master does not answer; then it has forgotten, or is told later."""
        if not self._answers:
            return
        try:
            await self.call(method, *params, timeout_s=_LEAVE_S)
        except (MasterRefused, ConnectFailed):
            return

    async def register_subscriber(self, topic: str, type: str, uri: str) -> list[str]:
        """Subscribe; gives the URIs of the topic's publishers."""
        return _texts(await self.call("registerSubscriber", topic, type, uri))

    async def register_publisher(self, topic: str, type: str, uri: str) -> list[str]:
        """Publish; gives the URIs of the topic's subscribers."""
        return _texts(await self.call("registerPublisher", topic, type, uri))

    async def register_service(self, service: str, api: str, uri: str) -> None:
        """Serve; ``api`` is ``rosrpc://host:port``."""
        await self.call("registerService", service, api, uri)

    async def lookup_service(self, service: str, timeout_s: float = _CALL_S) -> str | None:
        """Return where a service is served, ``rosrpc://host:port``; ``None`` if nobody serves it."""
        try:
            return str(await self.call("lookupService", service, timeout_s=timeout_s)) or None
        except MasterRefused:
            return None

    async def lookup_node(self, node: str) -> str | None:
        """Return the URI of a node, ``None`` if the master does not know it."""
        try:
            return str(await self.call("lookupNode", node)) or None
        except MasterRefused:
            return None

    async def system_state(self) -> tuple[dict[str, list[str]], dict[str, list[str]], dict[str, list[str]]]:
        """Return publishers, subscribers and service providers: names to the nodes that have them."""
        state = await self.call("getSystemState")
        try:
            publishers, subscribers, services = ({str(name): _texts(nodes) for name, nodes in part} for part in state)
        except (TypeError, ValueError):
            raise ConnectFailed(self.uri, "the system state cannot be understood") from None
        return publishers, subscribers, services

    async def topic_types(self) -> dict[str, str]:
        """Return the types of all topics, ``pkg/Name`` or ``*``."""
        try:
            return {str(topic): str(type) for topic, type in await self.call("getTopicTypes")}
        except (TypeError, ValueError):
            raise ConnectFailed(self.uri, "the topic types cannot be understood") from None

    # ── parameters ─────────────────────────────────────────────────────────────────────────────────────────────

    async def get_param(self, name: str) -> Any:
        """Return a parameter, or a namespace of them as a dict. Raises ``KeyError`` if there is none."""
        try:
            return await self.call("getParam", name)
        except MasterRefused:
            raise KeyError(name) from None

    async def set_param(self, name: str, value: Any) -> None:
        """Set a parameter, or all of a namespace from a dict; what was there before goes."""
        await self.call("setParam", name, value)

    async def delete_param(self, name: str) -> None:
        """Delete a parameter or a namespace. Raises ``KeyError`` if there is none."""
        try:
            await self.call("deleteParam", name)
        except MasterRefused:
            raise KeyError(name) from None

    async def list_params(self) -> list[str]:
        """Return the names of all parameters."""
        return sorted(_texts(await self.call("getParamNames")))


def _texts(value: Any) -> list[str]:
    return [str(item) for item in value] if isinstance(value, (list, tuple)) else []
