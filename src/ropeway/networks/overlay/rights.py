"""Defines the rights of a member, as its certificate gives them."""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from typing import Any, Final

from ropeway.types.untrusted import json_value

__all__ = ["EVERYTHING", "VERBS", "Rights"]

VERBS: Final = ("publish", "subscribe", "call", "offer")

_ACTION_PART: Final = "/_action/"
_ACTIONS: Final = {"publish": "offer", "subscribe": "call"}


@dataclass(frozen=True, slots=True)
class Rights:
    """Lists patterns of absolute ROS names per verb; ``*`` stands for any text, slashes included.

    What an action is made of is judged by the action's name: who may ``call`` it may read its feedback, who may
    ``offer`` it may publish it.
    """

    publish: tuple[str, ...] = ()
    subscribe: tuple[str, ...] = ()
    call: tuple[str, ...] = ()
    offer: tuple[str, ...] = ()

    def may(self, verb: str, name: str) -> bool:
        """Return whether ``verb`` is allowed on ``name``."""
        if _ACTION_PART in name:
            name = name.partition(_ACTION_PART)[0]
            verb = _ACTIONS.get(verb, verb)
        patterns: tuple[str, ...] = getattr(self, verb)
        return any(fnmatchcase(name, pattern) for pattern in patterns)

    def to_json(self) -> bytes:
        """Return the form that stands in a certificate."""
        return json.dumps(asdict(self), separators=(",", ":")).encode()

    @classmethod
    def from_json(cls, raw: bytes) -> Rights:
        """Read it. Raises ``ValueError`` for anything else."""
        found: Any = json_value(raw)
        if not isinstance(found, dict) or not found.keys() <= set(VERBS):
            raise ValueError("no rights")
        for patterns in found.values():
            if not isinstance(patterns, list) or not all(isinstance(pattern, str) for pattern in patterns):
                raise ValueError("no rights")
        return cls(**{verb: tuple(patterns) for verb, patterns in found.items()})


EVERYTHING: Final = Rights(("*",), ("*",), ("*",), ("*",))
"""The rights of a member without explicit rights."""
