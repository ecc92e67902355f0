"""Draws what changes anew, in place, until Ctrl-C."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable
from typing import NoReturn

from rich.console import Group, RenderableType
from rich.live import Live

__all__ = ["draw_until_interrupted"]


def draw_until_interrupted(parts: Callable[[], Iterable[RenderableType]], *, period_s: float) -> NoReturn:
    """Draw what ``parts()`` gives, one below the other, every ``period_s``."""
    with Live(auto_refresh=False) as screen:
        while True:
            screen.update(Group(*parts()), refresh=True)
            time.sleep(period_s)
