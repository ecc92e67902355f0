"""States of the machines of groups, told over the sealed channels between gateways, not over the topics that cross.

A robot's gateway tells each machine its state, again and again; a machine holds it by lease. Of several states for one
machine the last counts: while one is on its way, those in between are left out.
"""

from __future__ import annotations

import logging
from collections.abc import Mapping
from typing import Any, Final

from ropeway.errors import RopewayError
from ropeway.group.state_lease import LEASE_S, HeldStates, StateLease
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.rpc import Rpc
from ropeway.tasks import Chores

__all__ = ["States"]

log = logging.getLogger("ropeway.group")

_ASK_S: Final = LEASE_S / 3  # then the next renewal is due
_OP: Final = "state"


class States:
    """Tells other gateways their states, and holds ours."""

    def __init__(self, rpc: Rpc) -> None:
        self._rpc = rpc
        self._held = HeldStates()
        self._to_tell: dict[tuple[bytes, str], str] = {}  # gateway and group: the state, while one is being told
        self._telling = Chores()

    def open(self) -> None:
        """Take states from now on."""
        self._rpc.answers(_OP, self._told)

    async def close(self) -> None:
        """Tell nobody any more; what they hold runs out."""
        await self._telling.close()
        self._to_tell.clear()

    def tell(self, gateway: bytes, group: str, state: str) -> None:
        """Tell a gateway its state in a group, without waiting; one that cannot be reached is told the next time."""
        key = gateway, group
        busy = key in self._to_tell
        self._to_tell[key] = state
        if not busy:
            self._telling.start(self._tell(gateway, group), f"state of {gateway.hex()[:8]} in {group}")

    async def _tell(self, gateway: bytes, group: str) -> None:
        key, told = (gateway, group), ""
        try:
            while self._to_tell[key] != told:
                told = self._to_tell[key]
                await self._rpc.ask(gateway, StateLease.message(group, told), _ASK_S)
        except RopewayError as error:  # it is not there, or knows no states
            log.debug("overlay: %s was not told its state in %s: %s", gateway.hex()[:8], group, error)
        finally:
            self._to_tell.pop(key, None)

    async def _told(self, peer: Certificate, request: Mapping[str, Any]) -> None:
        self._held.told(request, peer.name)

    @property
    def pending(self) -> int:
        """Return how many states are on their way."""
        return len(self._to_tell)

    def status(self) -> list[dict[str, str]]:
        """Return the states that we hold, as JSON."""
        return self._held.status()
