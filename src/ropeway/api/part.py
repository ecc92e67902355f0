"""Defines the base of every part that a program makes on a graph: it has a view of its own, and can be closed."""

from __future__ import annotations

from typing import TYPE_CHECKING

from ropeway.api.opening import Closing

if TYPE_CHECKING:
    from ropeway.hub.hub import View

__all__ = ["Part"]


class Part(Closing):
    """A publisher, subscription, client, service or action of a program.

    The view is its alone: so it hears all other parts of the same graph, and closing the view closes it.
    """

    def __init__(self, view: View) -> None:
        self.closed = False
        self._view = view

    async def close(self) -> None:
        """Take it back from the graph; once is enough, and more do no harm."""
        self.closed = True
        await self._view.close()
