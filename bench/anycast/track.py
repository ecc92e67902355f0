"""Draws the track of a robot that follows a target on a circle, from when its frames were answered."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

__all__ = ["draw", "track"]

RADIUS_M: Final = 0.5
TURN_S: Final = 12.0  # for the whole circle
KEPT_S: Final = 0.05  # an older answer tells where the target was, and the robot does not see it any more
DRIFT_M: Final = 0.004  # off the circle with each frame that is answered too late
RETURN: Final = 0.8  # of the way back to the circle remains with each frame that is answered in time


def track(found: Mapping[str, Any]) -> list[tuple[float, float]]:
    """Return where the robot is at each frame: on the circle while answers are in time, off it while they are not."""
    points, off_m = [], 0.0
    begins = found["sent"][0]
    for sent, took in zip(found["sent"], found["latency_s"], strict=True):
        off_m = off_m + DRIFT_M if took is None or took > KEPT_S else off_m * RETURN
        angle = 2 * math.pi * (sent - begins) / TURN_S
        points.append(((RADIUS_M + off_m) * math.cos(angle), (RADIUS_M + off_m) * math.sin(angle)))
    return points


def draw(path: Path, found: Mapping[str, Any], delayed_s: float, change_s: float | None) -> None:
    """Write a picture of the track and of the latencies."""
    import matplotlib

    matplotlib.use("Agg")
    from matplotlib import pyplot
    from matplotlib.patches import Circle

    figure, (left, right) = pyplot.subplots(1, 2, figsize=(11, 5))
    xs, ys = zip(*track(found), strict=True)
    circle = Circle((0, 0), RADIUS_M, fill=False, linestyle="--", color="0.6")
    left.add_patch(circle)
    left.plot(xs, ys, linewidth=1.5)
    left.set_aspect("equal")
    left.set(title="track of the robot", xlabel="m", ylabel="m")
    begins = found["sent"][0]
    times = [sent - begins for sent in found["sent"]]
    right.plot(times, [None if t is None else 1e3 * t for t in found["latency_s"]], ".", markersize=3)
    right.axvline(delayed_s - begins, color="tab:red", label="50 ms more on edge1")
    if change_s is not None:
        right.axvline(change_s - begins, color="tab:green", label="edge2 is used")
    right.set(title="latency of each frame", xlabel="s", ylabel="ms")
    right.legend()
    figure.tight_layout()
    figure.savefig(path, dpi=120)
    pyplot.close(figure)
