"""Manages a running gateway for the control API: what it shows, and what may be asked of it."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any

from ropeway.control.events import Events
from ropeway.gateway.auth import make_door

if TYPE_CHECKING:
    from ropeway.gateway.config.config import Config
    from ropeway.gateway.gateway import Gateway
    from ropeway.gateway.process.questions import Question
    from ropeway.gateway.process.supervisor import Supervisor
    from ropeway.listener.authentication import Door

__all__ = ["Manager"]

log = logging.getLogger("ropeway.control")


class Manager:
    """Stands between the control API and what runs: a gateway in this process, or the supervisor of workers."""

    def __init__(self, running: Gateway | Supervisor) -> None:
        self.running = running
        self.events = Events()
        self._on_door: list[Callable[[Door], None]] = []

    @property
    def config(self) -> Config:
        """The configuration that runs."""
        return self.running.config

    def status(self) -> dict[str, Any]:
        """Return the state of everything as JSON."""
        return self.running.status()

    async def ask(self, question: Question, params: Mapping[str, Any]) -> list[Any]:
        """Return the answers of the gateway, or of all its workers, to a question (``gateway/process/questions.py``).

        Raises what one of them raises.
        """
        return await self.running.ask(question, params)

    def on_door(self, renew: Callable[[Door], None]) -> None:
        """Call ``renew`` with the rules for who may come in, whenever they have changed."""
        self._on_door.append(renew)

    def reload(self) -> None:
        """Read certificates and tokens again, for the listeners and for the control API. Raises ``ConfigError``."""
        door = make_door(self.config.gateway)
        self.running.reload()
        for renew in self._on_door:
            renew(door)

    async def close(self) -> None:
        """End what the manager began."""
        self.events.close()
