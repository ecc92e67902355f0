"""Ids by which clients register topics and take registrations back."""

from __future__ import annotations

from typing import Final

from ropeway.errors import InvalidOperation
from ropeway.limits import IDS_PER_TOPIC
from ropeway.networks.rosbridge.protocol import ops

__all__ = ["add_id", "id_key", "remove_request"]

_NO_ID: Final = "\0none"


def add_id(ids: set[str], id: object) -> None:
    """Add the id of a registration. Raises ``InvalidOperation`` for one too many."""
    if len(ids) >= IDS_PER_TOPIC:
        raise InvalidOperation("", f"a topic may have {IDS_PER_TOPIC} ids at most")
    ids.add(id_key(id))


def remove_request(requests: dict[str, ops.Subscribe], id: object) -> None:
    """Remove one request, or all where no id is given."""
    if ops.present(id):
        requests.pop(id_key(id), None)
    else:
        requests.clear()


def id_key(id: object) -> str:
    """Return an id, of whatever JSON type, as a key; operations without one share a key."""
    return repr(id) if ops.present(id) else _NO_ID
