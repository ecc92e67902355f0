"""Services and actions: what a ``Graph`` offers to callers, and what it expects of providers.

Rules that hold for every kind (``tests/contract`` checks them):

* payloads are CDR with their 4-byte header, as for topics: of ``pkg/srv/Name_Request``, ``pkg/srv/Name_Response``,
  ``pkg/action/Name_Goal``, ``…_Result`` and ``…_Feedback``;
* any number of calls and goals at a time; each is answered exactly once: a response, a ``CallError``, or, when the
  time is over, ``CallTimeout``;
* a provider or a link that vanishes fails its calls at once (``ProviderLost``) and aborts its goals;
* a handler runs as a task of its own, so that a slow one delays nobody, or begins at once and waits for nothing
  (``ropeway.graph.begun``); one that raises fails this call only;
* a caller that stops waiting (timeout, cancelled task, ``close``) is forgotten: a late answer is dropped and counted.
"""

from __future__ import annotations

import asyncio
import enum
import os
from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from typing import Final, Protocol, runtime_checkable

__all__ = [
    "DEFAULT_TIMEOUT_S",
    "ActionClient",
    "ActionHandlers",
    "ActionInfo",
    "ActionServer",
    "Client",
    "ClientGoal",
    "Goal",
    "GoalStatus",
    "Outcome",
    "ProviderInfo",
    "Request",
    "ServerGoal",
    "Service",
    "ServiceHandler",
    "ServiceInfo",
    "new_id",
]

DEFAULT_TIMEOUT_S: Final = 5.0
"""How long a call waits unless told otherwise: rosbridge's ``default_call_service_timeout``."""


def new_id() -> bytes:
    """Return 16 random bytes that name a call or a goal (a version 4 UUID, as ROS makes for goals)."""
    raw = bytearray(os.urandom(16))
    raw[6] = raw[6] & 0x0F | 0x40
    raw[8] = raw[8] & 0x3F | 0x80
    return bytes(raw)


@dataclass(slots=True, eq=False)
class Request:
    """A call on its way.

    ``payload``: CDR of the request. ``id``: 16 bytes that name the call; the same call never runs twice. ``via``: the
    ids of the gateways that it passed, so that it cannot go in circles. ``caller``: who called, for people.
    ``timeout_s``: how long the caller waits, ``None`` where that is not known.
    """

    payload: bytes
    id: bytes = field(default_factory=new_id)
    via: tuple[str, ...] = ()
    caller: str = ""
    timeout_s: float | None = None


ServiceHandler = Callable[[Request], Awaitable[bytes]]
"""Answers a request with the CDR of the response. A ``CallError`` that it raises fails the call with its text."""


@runtime_checkable
class Client(Protocol):
    """A service that we call on a graph."""

    service: str
    type: str

    @property
    def available(self) -> bool | None:
        """Whether a provider serves it now, ``None`` if the network cannot tell before a call."""

    async def wait_available(self, timeout_s: float) -> bool:
        """Wait until somebody serves it; true at once where the network cannot tell. False when the time is over."""

    async def call(self, request: Request, timeout_s: float = DEFAULT_TIMEOUT_S) -> bytes:
        """Call the service and return the CDR of the response.

        Waits for a provider within the time. Raises ``NotServed`` (nobody serves it), ``CallTimeout``,
        ``ProviderLost``, ``CallFailed`` (the provider says why), or ``GraphUnavailable`` after ``close``.
        """

    async def close(self) -> None:
        """Stop calling; calls under way fail with ``GraphUnavailable``."""


@runtime_checkable
class Service(Protocol):
    """A service that we serve on a graph."""

    service: str
    type: str

    async def close(self) -> None:
        """Stop serving; calls under way fail with ``ProviderLost`` where the network can say so."""


class GoalStatus(enum.IntEnum):
    """action_msgs/msg/GoalStatus."""

    UNKNOWN = 0
    ACCEPTED = 1
    EXECUTING = 2
    CANCELING = 3
    SUCCEEDED = 4
    CANCELED = 5
    ABORTED = 6

    @property
    def final(self) -> bool:
        """Whether the goal has ended."""
        return self >= GoalStatus.SUCCEEDED


@dataclass(slots=True, eq=False)
class Goal:
    """A goal on its way: ``payload`` is the CDR of ``pkg/action/Name_Goal``; for the rest see ``Request``."""

    payload: bytes
    id: bytes = field(default_factory=new_id)
    via: tuple[str, ...] = ()
    caller: str = ""


@dataclass(frozen=True, slots=True)
class Outcome:
    """The end of a goal: SUCCEEDED, CANCELED or ABORTED.

    ``payload`` is the CDR of ``pkg/action/Name_Result``, ``None`` where there is none (the graph sends the default
    values then). ``text`` says why a goal was aborted, where anybody knows. ``rejected`` tells that it was never
    accepted, on a network that says so at the end only.
    """

    status: GoalStatus
    payload: bytes | None = None
    text: str = ""
    rejected: bool = False


@runtime_checkable
class ClientGoal(Protocol):
    """A goal that was accepted."""

    id: bytes

    async def result(self, timeout_s: float | None = None) -> Outcome:
        """Wait for the end of the goal and return its outcome. May be awaited again. ABORTED if the provider or the
        link vanishes; raises ``CallTimeout``.
        """

    async def cancel(self, timeout_s: float = DEFAULT_TIMEOUT_S) -> bool:
        """Ask for its end. True if the provider agreed (the outcome follows), false if it refused or does not know it.

        Raises ``CallError`` if nobody answers.
        """


@runtime_checkable
class ActionClient(Protocol):
    """An action that we use on a graph."""

    action: str
    type: str

    @property
    def available(self) -> bool | None:
        """Whether a provider serves it now, ``None`` if the network cannot tell before a goal is sent."""

    async def wait_available(self, timeout_s: float) -> bool:
        """Wait until somebody serves it; true at once where the network cannot tell. False when the time is over."""

    async def send_goal(
        self,
        goal: Goal,
        *,
        on_feedback: Callable[[bytes], None] | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> ClientGoal:
        """Send a goal and wait until it is accepted. ``on_feedback`` gets the CDR of ``pkg/action/Name_Feedback``.

        Raises ``GoalRejected``, ``NotServed``, ``CallTimeout``, ``ProviderLost``, ``CallFailed``. Where the network
        tells a rejection only with the outcome (rosbridge), ``result`` gives ABORTED with the text instead.
        """

    async def close(self) -> None:
        """Forget the action; outcomes still awaited are ABORTED."""


@dataclass(slots=True, eq=False)
class ServerGoal:
    """A goal as its provider sees it.

    ``feedback(payload)`` sends the CDR of ``pkg/action/Name_Feedback``; look it up at each use. What is given before
    the goal is accepted is sent right after. ``cancelled`` is set when somebody asked for its end and the provider
    agreed. ``accept``, ``execute`` and ``cancel`` get one and the same object.
    """

    payload: bytes
    id: bytes
    feedback: Callable[[bytes], None]
    via: tuple[str, ...] = ()
    caller: str = ""
    cancelled: asyncio.Event = field(default_factory=asyncio.Event)


@dataclass(frozen=True, slots=True)
class ActionHandlers:
    """The callbacks of an action server.

    ``execute`` carries a goal out; what it raises aborts the goal. ``accept`` says whether a goal is taken (left out:
    every one), ``cancel`` whether its end is agreed to (left out: always).
    """

    execute: Callable[[ServerGoal], Awaitable[Outcome]]
    accept: Callable[[ServerGoal], Awaitable[bool]] | None = None
    cancel: Callable[[ServerGoal], Awaitable[bool]] | None = None


@runtime_checkable
class ActionServer(Protocol):
    """An action that we serve on a graph."""

    action: str
    type: str

    async def close(self) -> None:
        """Stop serving: goals under way are aborted, new ones rejected."""


@dataclass(frozen=True, slots=True)
class ProviderInfo:
    """A provider or user of a service or action.

    ``node``, ``gateway`` and ``local`` as in ``EndpointInfo``. ``since_ns``: when a gateway began to serve it
    (``time.time_ns``), 0 where nobody tells.
    """

    node: str = ""
    gateway: str = ""
    local: bool = False
    gid: bytes = b""
    since_ns: int = 0

    def __str__(self) -> str:
        if self.gateway:
            return f"gateway {self.gateway}"
        return f"node {self.node}" if self.node else "a participant without a node"


@dataclass(frozen=True, slots=True)
class ServiceInfo:
    """A service as it stands. Services of actions (``/x/_action/send_goal``) are listed, too."""

    name: str
    types: tuple[str, ...]
    servers: tuple[ProviderInfo, ...] = ()
    clients: tuple[ProviderInfo, ...] = ()

    @property
    def type(self) -> str:
        """The first type, or ``""``."""
        return self.types[0] if self.types else ""


@dataclass(frozen=True, slots=True)
class ActionInfo:
    """An action as it stands."""

    name: str
    types: tuple[str, ...]
    servers: tuple[ProviderInfo, ...] = ()
    clients: tuple[ProviderInfo, ...] = ()

    @property
    def type(self) -> str:
        """The first type, or ``""``."""
        return self.types[0] if self.types else ""
