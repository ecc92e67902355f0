"""The command ``ropeway``."""

from __future__ import annotations

import importlib
import os
import sys
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ropeway.cli.verbs import VERBS, app

__all__ = ["VERBS", "app", "main"]


def __getattr__(name: str) -> Any:
    """Return the verbs, which are imported when somebody asks: a gateway runs without what reads their options."""
    if name not in ("VERBS", "app"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module("ropeway.cli.verbs"), name)


def main() -> None:
    """Run the command line; the entry point of the package."""
    os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")  # to look for them reads the metadata of all packages
    if sys.argv[1:2] == ["run"]:
        from ropeway.cli.plain_run import plain_order, run_plainly

        order = plain_order(sys.argv[2:])
        if order is not None:
            run_plainly(order)
            return
    from ropeway.cli.verbs import app

    app(prog_name="ropeway")  # however it was started: the package for Debian has no script of that name
