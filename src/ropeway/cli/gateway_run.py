"""Runs the gateway that a file describes, as ``ropeway run`` orders."""

from __future__ import annotations

import logging
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from ropeway.cli.logs import set_up
from ropeway.cli.loop import run

if TYPE_CHECKING:
    from ropeway.gateway.gateway import Gateway
    from ropeway.gateway.process.supervisor import Supervisor

__all__ = ["LEAST_PERIOD_S", "RunOrder", "run_gateway"]

LEAST_PERIOD_S: Final = 0.05
"""The shortest time between two lines of the status."""

log = logging.getLogger("ropeway")


@dataclass(frozen=True, slots=True)
class RunOrder:
    """Says which gateway is run, for how long, and what it shows; the fields are the options of ``ropeway run``."""

    config: Path
    for_s: float = 0.0
    as_json: bool = False
    period: float = 1.0
    log_level: str = "info"
    part: str = ""
    watch: bool = False
    live: bool | None = None
    quiet: bool = False


def run_gateway(order: RunOrder) -> None:
    """Run it until it is told to stop. Raises ``RopewayError`` if it cannot be brought up."""
    level = set_up("warning" if order.quiet else order.log_level)
    from ropeway.cli.serving import Serving, serve
    from ropeway.gateway.config.fleet import load_one

    loaded = load_one(order.config, order.part)
    try:
        period_s = order.period if order.as_json else None
        on_terminal = sys.stdout.isatty() and not order.quiet
        drawn = not order.as_json and (on_terminal if order.live is None else order.live)
        shown = Serving(
            loaded, level, order.for_s or None, period_s, up=_greet, control=True, watch=order.watch, live=drawn
        )
        run(serve(shown))
    except KeyboardInterrupt:  # before the handler was there: nothing had been started
        return


def _greet(gateway: Gateway | Supervisor) -> None:
    config = gateway.config
    listen = ", ".join(config.gateway.listen) or 'nowhere ("listen" names no port)'
    remotes = sum(remote.active for remote in config.remotes)
    log.info(
        "%s is on %s, listens at %s, and has %d route(s) to %d remote(s)",
        config.gateway.name,
        ", ".join(config.gateway.graphs),
        listen,
        len(config.routes()),
        remotes,
    )
    if any(remote.link is not None for remote in config.remotes):
        from ropeway.planning.configured import unfitting  # a link of which nothing is said carries everything

        for sentence in unfitting(config):
            log.warning("%s", sentence)
