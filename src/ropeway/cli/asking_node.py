"""Asks one node for something, with sentences for one that is not there or does not answer."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Any, TypeVar

from ropeway.cli.console import fail
from ropeway.cli.loop import run
from ropeway.cli.patience import patiently
from ropeway.cli.session import OpenGraph, open_session
from ropeway.errors import CallTimeout, NotServed

__all__ = ["ask_node"]

T = TypeVar("T")


def ask_node(
    graph: str,
    node: str,
    timeout_s: float,
    work: Callable[[OpenGraph], Coroutine[Any, Any, T]],
    *,
    lacking: str,
    listing: str,
) -> T:
    """Run ``work`` on the graph at the URL; a node that does not answer ends with a sentence.

    ``lacking`` says what a node is that has not the services asked for, ``listing`` which verb lists those that have;
    ``node`` may be ``""`` for all of them.
    """
    whom = f"node {node}" if node else "the nodes"

    async def main() -> T:
        async with (
            open_session(graph) as session,
            patiently(lambda: f"waiting for {whom} to answer ({timeout_s:g} s at most)"),
        ):
            return await work(session)

    try:
        return run(main())
    except NotServed:
        fail(
            f"{whom} {lacking}, or is not there (waited {timeout_s:g} s); "
            f"see `ropeway {listing}`, or wait longer with --timeout"
        )
    except CallTimeout:
        fail(f"{whom} did not answer within {timeout_s:g} s; wait longer with --timeout")
