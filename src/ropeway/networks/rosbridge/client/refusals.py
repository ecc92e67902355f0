"""Answers to operations of a server that cannot be understood but say which they are."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from ropeway.errors import InvalidOperation, WireError
from ropeway.networks.rosbridge.protocol import ops

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.client.calls import Calls
    from ropeway.networks.rosbridge.link.peer import Peer

__all__ = ["answer_invalid"]

_ABORTED: Final = 6  # as in action_msgs/GoalStatus


def answer_invalid(peer: Peer, calls: Calls, message: Mapping[str, Any], error: WireError) -> None:
    """Answer a request that cannot be understood, and fail a call whose answer cannot be."""
    peer.fault_log.note("operation", str(message.get("topic", ""))[:200], error)
    if (answer := _answer_to(message, error)) is not None:
        peer.send(answer)
    elif (failure := _failure_in(message, error)) is not None:
        calls.operation(failure, peer)


def _answer_to(message: Mapping[str, Any], error: WireError) -> ops.Op | None:
    """Return the answer to a request that cannot be understood; ``None`` if it names no request."""
    id = _id(error)
    name = message.get("service", message.get("action"))
    if not isinstance(name, str) or not ops.present(id):
        return None
    if message.get("op") == "call_service":
        return ops.ServiceResponse(service=name, values=str(error), result=False, id=id)
    if message.get("op") == "send_action_goal":
        return ops.ActionResult(action=name, values=str(error), status=_ABORTED, result=False, id=id)
    return None


def _failure_in(message: Mapping[str, Any], error: WireError) -> ops.Op | None:
    """Return a failure to replace an answer that cannot be understood, for whoever waits for it."""
    id = _id(error)
    name = message.get("service", message.get("action", ""))
    if not ops.present(id):
        return None
    if message.get("op") == "service_response":
        return ops.ServiceResponse(service=str(name), values=str(error), result=False, id=id)
    if message.get("op") == "action_result":
        return ops.ActionResult(action=str(name), values=str(error), status=_ABORTED, result=False, id=id)
    return None


def _id(error: WireError) -> object:
    return error.id if isinstance(error, InvalidOperation) else ops.ABSENT
