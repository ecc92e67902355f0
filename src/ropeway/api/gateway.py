"""A gateway within a program: what ``ropeway.open_gateway`` gives."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ropeway.api.opening import Closing, Opening

if TYPE_CHECKING:
    from ropeway.gateway.config.config import Config
    from ropeway.gateway.gateway import Gateway
    from ropeway.gateway.process.supervisor import Supervisor

__all__ = ["AsyncGateway", "open_gateway"]


class AsyncGateway(Closing):
    """A gateway that a program runs; ``open_gateway`` brings it up."""

    def __init__(self, inner: Gateway | Supervisor) -> None:
        self._inner = inner
        self._closed = False

    @property
    def name(self) -> str:
        """Return the name of the gateway."""
        return self._inner.config.gateway.name

    @property
    def ports(self) -> list[int]:
        """Return the ports at which it listens for WebSockets, in the order of the configuration."""
        return [listener["port"] for listener in self.status()["listen"]]

    def status(self) -> dict[str, Any]:
        """Return everything as it stands, as ``ropeway run --json`` prints it."""
        return self._inner.status()

    def reload(self) -> None:
        """Read certificates and tokens again. Raises ``ConfigError`` if they are no good; nothing has changed then."""
        self._inner.reload()

    async def close(self) -> None:
        """Take the gateway down."""
        if not self._closed:
            self._closed = True
            await self._inner.__aexit__(None, None, None)


def open_gateway(
    config: Mapping[str, Any] | Sequence[Any] | str | Path | Config, *, part: str = ""
) -> Opening[AsyncGateway]:
    """Run the gateway that ``config`` describes, until it is closed.

    ``config`` is what ``ropeway run`` takes: the path of a JSON or YAML file, or what stands in one (see
    ``docs/configuration.md``), or a ``Config``. Relative paths in a file start at the file, others
    at the working directory. ``part`` names one of several gateways that stand in one document.

    Raises ``ConfigError`` with every fault, ``GraphUnavailable`` for a graph and ``ConnectFailed`` for a listener that
    cannot be had.
    """
    return Opening(_open(config, part))


async def _open(config: Mapping[str, Any] | Sequence[Any] | str | Path | Config, part: str) -> AsyncGateway:
    from ropeway.gateway.config.config import Config, parse  # programs without a gateway need not wait for it
    from ropeway.gateway.config.fleet import load_one, select
    from ropeway.gateway.factory import make_gateway

    if not isinstance(config, Config):
        config = load_one(config, part) if isinstance(config, (str, Path)) else parse(select(config, part), part=part)
    inner = make_gateway(config)
    await inner.__aenter__()
    return AsyncGateway(inner)
