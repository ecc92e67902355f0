"""Bridges and gateways for threads."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from ropeway.api import bridge as asynchronous
from ropeway.api import gateway as asynchronous_gateway
from ropeway.api.bridge import AsyncBridge
from ropeway.api.gateway import AsyncGateway
from ropeway.api.graph import OPEN_TIMEOUT_S
from ropeway.blocking.part import BlockingRoot, opened
from ropeway.blocking.portal import portal
from ropeway.graph.base import NO_HINTS, Delivery
from ropeway.graph.calls import DEFAULT_TIMEOUT_S
from ropeway.qos import QoS

if TYPE_CHECKING:
    from ropeway.gateway.config.config import Config

__all__ = ["BlockingBridge", "BlockingGateway", "open_bridge", "open_gateway"]

_START_S: Final = 60.0  # a gateway with workers waits for each, and for a ROS 1 master half a minute


def open_bridge(
    left: str,
    right: str,
    *,
    name: str = "",
    types: Iterable[str | Path] = (),
    timeout_s: float | None = OPEN_TIMEOUT_S,
) -> BlockingBridge:
    """Open two graphs by their URLs, to join names on them; see ``ropeway.open_bridge``."""

    async def work() -> AsyncBridge:
        return await asynchronous.open_bridge(left, right, name=name, types=types, timeout_s=timeout_s)

    return BlockingBridge(opened(work, None))


def open_gateway(config: Mapping[str, Any] | Sequence[Any] | str | Path | Config, *, part: str = "") -> BlockingGateway:
    """Run the gateway that ``config`` describes, until it is closed; see ``ropeway.open_gateway``."""

    async def work() -> AsyncGateway:
        return await asynchronous_gateway.open_gateway(config, part=part)

    return BlockingGateway(opened(work, _START_S))


class BlockingBridge(BlockingRoot[AsyncBridge]):
    """Joins names on two graphs of a program; see ``AsyncBridge``."""

    def topic(
        self,
        name: str,
        type: str = "",
        *,
        rename: str = "",
        reverse: bool = False,
        qos: QoS | str | None = None,
        delivery: Delivery = NO_HINTS,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> None:
        """Publish on the target what is published on the source; see ``AsyncBridge.topic``."""
        portal.wait(
            lambda: self._inner.topic(
                name, type, rename=rename, reverse=reverse, qos=qos, delivery=delivery, timeout_s=timeout_s
            ),
            timeout_s,
        )

    def service(
        self,
        name: str,
        type: str = "",
        *,
        rename: str = "",
        reverse: bool = False,
        call_timeout_s: float | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> None:
        """Offer on the target the service of the source; see ``AsyncBridge.service``."""
        portal.wait(
            lambda: self._inner.service(
                name, type, rename=rename, reverse=reverse, call_timeout_s=call_timeout_s, timeout_s=timeout_s
            ),
            timeout_s,
        )

    def action(
        self,
        name: str,
        type: str = "",
        *,
        rename: str = "",
        reverse: bool = False,
        goal_timeout_s: float | None = None,
        timeout_s: float = DEFAULT_TIMEOUT_S,
    ) -> None:
        """Offer on the target the action of the source; see ``AsyncBridge.action``."""
        portal.wait(
            lambda: self._inner.action(
                name, type, rename=rename, reverse=reverse, goal_timeout_s=goal_timeout_s, timeout_s=timeout_s
            ),
            timeout_s,
        )

    def status(self) -> list[dict[str, Any]]:
        """Return each name that is joined: its state and why it failed, and what has crossed, as JSON."""
        return portal.call(self._inner.status)


class BlockingGateway(BlockingRoot[AsyncGateway]):
    """A gateway that a program runs; ``open_gateway`` brings it up."""

    @property
    def name(self) -> str:
        """Return the name of the gateway."""
        return self._inner.name

    @property
    def ports(self) -> list[int]:
        """Return the ports at which it listens for WebSockets, in the order of the configuration."""
        return [listener["port"] for listener in self.status()["listen"]]

    def status(self) -> dict[str, Any]:
        """Return everything as it stands, as ``ropeway run --json`` prints it."""
        return portal.call(self._inner.status)

    def reload(self) -> None:
        """Read certificates and tokens again. Raises ``ConfigError`` if they are no good; nothing has changed then."""
        portal.call(self._inner.reload)
