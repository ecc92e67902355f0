"""The last values in the store of the gateway."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Final

from ropeway.control.resource import ControlRequest, Resources
from ropeway.errors import TypesError
from ropeway.limits import CONTROL_STORE_VALUES
from ropeway.store import CDR

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway
    from ropeway.store import Entry

__all__ = ["list_values", "resources"]

resources = Resources()

_SHOWN_CHARACTERS: Final = 200
_DECODED_BYTES: Final = 4096  # whoever watches asks for all of them once a second


@resources.get("/v1/store", gives=list[dict[str, Any]])
async def read_store(asked: ControlRequest) -> Any:
    """Return what the store keeps and the caller may read, the newest first; ``?system=`` and ``&topic=`` are patterns.

    Of a text there is the beginning, and of a message of ROS that is not large, as JSON.
    """
    params = {"system": asked.query.get("system") or "*", "topic": asked.query.get("topic") or "*"}
    role = asked.caller.role
    found = [value for answer in await asked.manager.ask(list_values, params) for value in answer]
    found = [v for v in found if not role.rule_against("subscribe", f"/{v['system']}/{v['topic']}")]
    return sorted(found, key=lambda value: value["age_s"])[:CONTROL_STORE_VALUES]


async def list_values(gateway: Gateway, params: Mapping[str, Any]) -> list[dict[str, Any]]:
    """Return the values of the store of one gateway."""
    store = gateway.store
    return [
        {
            "system": entry.system,
            "topic": entry.topic,
            "type": entry.type,
            "origin": entry.origin,
            "age_s": round(entry.age_s(), 3),
            "bytes": len(entry.data),
            "text": _shown(gateway, entry)[:_SHOWN_CHARACTERS],
        }
        for entry in (store.entries(params["system"], params["topic"]) if store is not None else ())
    ]


def _shown(gateway: Gateway, entry: Entry) -> str:
    if entry.form != CDR:
        return entry.text or ""
    if len(entry.data) > _DECODED_BYTES:
        return ""
    try:
        return gateway.registry.codec(entry.type).json(entry.data).decode(errors="replace")
    except TypesError:  # of a store that somebody else has written to, or of a type that is not known here
        return ""
