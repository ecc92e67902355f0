"""Services and actions that are served to every member of a group."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Generic, TypeVar

from ropeway.graph.calls import ActionServer, Service
from ropeway.group.chooser import Chooser

__all__ = ["GroupActionServer", "GroupService"]

S = TypeVar("S", Service, ActionServer)


class _Offer(Generic[S]):
    def __init__(self, group: Chooser, parts: Mapping[str, S]) -> None:
        self._group = group
        self._parts: dict[str, S] = dict(parts)

    async def close(self) -> None:
        """Serve it to no member any more."""
        for part in self._parts.values():
            await part.close()
        self._group.closed(self)


class GroupService(_Offer[Service]):
    """A service, served to every member."""

    def __init__(self, group: Chooser, service: str, type: str, parts: Mapping[str, Service]) -> None:
        super().__init__(group, parts)
        self.service, self.type = service, type


class GroupActionServer(_Offer[ActionServer]):
    """An action, served to every member."""

    def __init__(self, group: Chooser, action: str, type: str, parts: Mapping[str, ActionServer]) -> None:
        super().__init__(group, parts)
        self.action, self.type = action, type
