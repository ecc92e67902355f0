"""Configures how a scheduler decides."""

from __future__ import annotations

from dataclasses import dataclass

from ropeway.group.latency import WINDOW_S

__all__ = ["PAUSE_S", "PROFILE_S", "Options"]

PROFILE_S = 0.1
"""How long each member is asked at the start: 100 ms in the thesis."""

PAUSE_S = 0.0
"""How long nothing is judged after that; the thesis waits 500 ms for its video encoder, which most machines lack."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Options:
    """Configures how a scheduler decides.

    ``profile_s``: how long each member is asked at the start, in turns with the others, and ``pause_s`` how long
    nothing is judged after that. ``pairs``: how many requests two members must both have had before they are compared.
    ``margin``: by how much of its latency the one in use must be beaten. ``least_dwell_s``: no second change sooner,
    unless the member is gone or the change proves wrong. ``penalty_s``: how long the loser of a comparison is left
    alone, doubled with each loss; after ``forgive_s`` without one it starts anew, and what was known of a member that
    nobody has asked since counts no more. ``judge_results``: the latency of an action is the time until a goal has
    succeeded, and not until it is accepted.
    """

    window_s: float = WINDOW_S
    profile_s: float = PROFILE_S
    pause_s: float = PAUSE_S
    pairs: int = 4
    margin: float = 0.1
    least_dwell_s: float = 1.0
    penalty_s: float = 2.0
    forgive_s: float = 60.0
    judge_results: bool = False
