"""Questions to gateways, wherever they run: functions that are called with a gateway, here or in its worker.

A question is ``async def question(gateway: Gateway, params: Mapping[str, Any]) -> Any`` at the top of a module. Its
name crosses the pipe to a worker; ``params`` and the answer are JSON.
"""

from __future__ import annotations

from collections.abc import Awaitable, Callable, Mapping
from typing import Any

from ropeway.loading import load

__all__ = ["Question", "find_question", "question_name"]

Question = Callable[[Any, Mapping[str, Any]], Awaitable[Any]]  # of a Gateway, which knows questions


def question_name(question: Question) -> str:
    """Return the name of a question, for another process."""
    return f"{question.__module__}:{question.__qualname__}"


async def find_question(name: str) -> Question:
    """Return the question of a name, which came from our own supervisor; messages cross while it is loaded."""
    module, _, function = name.partition(":")
    found: Question = getattr(await load(module), function)
    return found
