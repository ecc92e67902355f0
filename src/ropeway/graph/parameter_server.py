"""Says how a network is asked that keeps the parameters of all its nodes in one place, as a ROS 1 master does."""

from __future__ import annotations

from typing import Any, Protocol, runtime_checkable

__all__ = ["ParameterServer"]


@runtime_checkable
class ParameterServer(Protocol):
    """A graph whose network keeps all parameters in one place."""

    async def get_param(self, name: str) -> Any:
        """Return the value of a parameter. Raises ``KeyError``."""

    async def set_param(self, name: str, value: Any) -> None:
        """Set it. Raises ``ValueError`` for what cannot be kept."""

    async def delete_param(self, name: str) -> None:
        """Delete it. Raises ``KeyError``."""

    async def list_params(self) -> list[str]:
        """Return all names."""
