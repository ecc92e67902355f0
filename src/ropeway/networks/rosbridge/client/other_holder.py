"""Track who else holds a name that we offer."""

from __future__ import annotations

import logging
from collections.abc import Callable

__all__ = ["OtherHolder"]

log = logging.getLogger("ropeway.rosbridge")


class OtherHolder:
    """Tracks who else holds a name that we offer, as the far gateway reports."""

    def __init__(self, graph: str, kind: str, name: str) -> None:
        self.by = ""
        self._graph, self._kind, self._name = graph, kind, name
        self._callbacks: list[Callable[[str], None]] = []
        self._said = ""

    def on_state(self, callback: Callable[[str], None]) -> None:
        """Call with who or what stands in the way, ``""`` for nobody, now and at each change."""
        self._callbacks.append(callback)
        callback(self.by)

    def tell(self, by: str) -> None:
        """Note that the far gateway refused the name, or (``""``) has granted it."""
        if by and by != self._said:
            log.info("%s: %s %s was refused: %s", self._graph, self._kind, self._name, by)
            self._said = by
        if by != self.by:
            self.by = by
            for callback in self._callbacks:
                callback(by)
