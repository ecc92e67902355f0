"""Runs a gateway as its service does, without what reads the options of all verbs.

That takes a megabyte for as long as the gateway runs, and some of the time until it is up. Whatever is not among the
plain options of ``ropeway run``, or not as they should be, is left to the command line, which explains it.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, Final

from ropeway.cli.console import reported
from ropeway.cli.gateway_run import LEAST_PERIOD_S, RunOrder, run_gateway

__all__ = ["plain_order", "run_plainly"]

_FLAGS: Final[Mapping[str, tuple[str, bool]]] = {
    "--json": ("as_json", True),
    "--watch": ("watch", True),
    "--live": ("live", True),
    "--no-live": ("live", False),
    "--quiet": ("quiet", True),
    "-q": ("quiet", True),
}
_VALUES: Final[Mapping[str, tuple[str, Callable[[str], Any], Callable[[Any], bool]]]] = {
    "--for": ("for_s", float, lambda value: value >= 0.0),
    "--period": ("period", float, lambda value: value >= LEAST_PERIOD_S),
    "--log-level": ("log_level", str, lambda _: True),
    "--as": ("part", str, lambda _: True),
}
_COMPLETES: Final = "_ROPEWAY_COMPLETE"  # a shell asks for what could follow


def plain_order(args: Sequence[str]) -> RunOrder | None:
    """Return what the words after ``ropeway run`` order, ``None`` if that is more than one file and plain options."""
    if _COMPLETES in os.environ:
        return None
    found: dict[str, Any] = {}
    files: list[str] = []
    words = iter(args)
    for word in words:
        name, given, text = word.partition("=")
        if word in _FLAGS:
            key, value = _FLAGS[word]
            found[key] = value
        elif name in _VALUES:
            key, read, fits = _VALUES[name]
            try:
                found[key] = read(text if given else next(words))
            except (StopIteration, ValueError):
                return None
            if not fits(found[key]):
                return None
        elif word.startswith("-"):
            return None
        else:
            files.append(word)
    return RunOrder(Path(files[0]), **found) if len(files) == 1 else None


def run_plainly(order: RunOrder) -> None:
    """Run the gateway; end the process with the exit code that the command line has for an error."""
    try:
        with reported():
            run_gateway(order)
    except RuntimeError as error:  # as the end that ``reported`` makes of an error is
        from typer import Exit

        if not isinstance(error, Exit):
            raise
        sys.exit(error.exit_code)
