"""Conditions on values of topics, such as ``/battery.percentage < 0.2``, that trigger a clip."""

from __future__ import annotations

import operator
import re
from collections.abc import Callable, Mapping
from typing import Any, Final

from ropeway.errors import InvalidName
from ropeway.graph.base import resolve_name

__all__ = ["Condition"]

_TEXT: Final = re.compile(
    r"\s*(?P<topic>/?[\w/]+)\.(?P<path>[\w.\[\]]+)\s*(?P<op>==|!=|<=|>=|<|>)\s*(?P<value>\S.*?)\s*"
)
_STEP: Final = re.compile(r"(\w+)|\[(\d+)\]")
_COMPARE: Final[Mapping[str, Callable[[Any, Any], bool]]] = {
    "==": operator.eq,
    "!=": operator.ne,
    "<": operator.lt,
    "<=": operator.le,
    ">": operator.gt,
    ">=": operator.ge,
}


class Condition:
    """A condition on a field of a topic. It holds anew when it becomes true, not as long as it is."""

    def __init__(self, text: str) -> None:
        """Read ``TOPIC.field.path OP VALUE``. Raises ``ValueError`` with what is expected."""
        import yaml  # which a gateway without conditions does without

        found = _TEXT.fullmatch(text)
        if found is None:
            raise ValueError(f"{text!r} is not a condition; write one such as '/battery.percentage < 0.2'")
        try:
            self.topic = resolve_name(found["topic"])
        except InvalidName as error:
            raise ValueError(str(error)) from None
        self.text = text.strip()
        self._steps = [name or int(index) for name, index in _STEP.findall(found["path"])]
        self._compare = _COMPARE[found["op"]]
        try:
            self._value = yaml.safe_load(found["value"])
        except yaml.YAMLError:
            raise ValueError(f"{found['value']!r} (in {text!r}) is not a value") from None
        self._held = False

    def becomes_true(self, message: Mapping[str, Any]) -> bool:
        """Return whether it holds for this message and did not for the one before. A field that is not there holds
        nothing.
        """
        before, self._held = self._held, self._holds(message)
        return self._held and not before

    def _holds(self, message: Mapping[str, Any]) -> bool:
        part: Any = message
        try:
            for step in self._steps:
                part = part[step]
            return bool(self._compare(part, self._value))
        except (LookupError, TypeError, ValueError):
            return False
