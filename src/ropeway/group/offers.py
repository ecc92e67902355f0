"""Services and actions that are served to every member of a group."""

from __future__ import annotations

from collections.abc import Mapping

from ropeway.graph.calls import ActionServer, Service
from ropeway.group.chooser import Chooser
from ropeway.group.part import GroupPart

__all__ = ["GroupActionServer", "GroupService"]


class GroupService(GroupPart[Service]):
    """A service, served to every member."""

    def __init__(self, group: Chooser, service: str, type: str, parts: Mapping[str, Service]) -> None:
        super().__init__(group, parts)
        self.service, self.type = service, type


class GroupActionServer(GroupPart[ActionServer]):
    """An action, served to every member."""

    def __init__(self, group: Chooser, action: str, type: str, parts: Mapping[str, ActionServer]) -> None:
        super().__init__(group, parts)
        self.action, self.type = action, type
