"""Reports what the robots did: in figures, and drawn side by side."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from ropeway.cli.demo_iort.robots import Track

__all__ = ["draw", "summary"]

_STILL_RAD: Final = math.radians(5)


def _turns(track: Track) -> list[float]:
    """Return the turns of a track, in degrees: stretches in which the heading changes, and what they add up to."""
    found: list[float] = []
    turning = 0.0
    quiet = 0
    for (_, _, _, before), (_, _, _, now) in itertools.pairwise(track):
        change = now - before
        if abs(change) > 1e-4:
            turning += change
            quiet = 0
            continue
        quiet += 1
        if quiet > 12 and abs(turning) > _STILL_RAD:
            found.append(math.degrees(turning))
        if quiet > 12:
            turning = 0.0
    if abs(turning) > _STILL_RAD:
        found.append(math.degrees(turning))
    return found


def summary(name: str, track: Track) -> dict[str, Any]:
    """Return metres and turns; ``ok`` if they are those of the script, a tenth of a second more or less."""
    metres = sum(math.hypot(b[1] - a[1], b[2] - a[2]) for a, b in itertools.pairwise(track))
    turns = _turns(track)
    ok = abs(metres - 1.5) < 0.3 and len(turns) == 2 and abs(turns[0] - 45) < 15 and abs(turns[1] - 180) < 20
    return {"robot": name, "metres": round(metres, 3), "turns_deg": [round(turn, 1) for turn in turns], "ok": ok}


def draw(tracks: Mapping[str, Track], output: Path) -> bool:
    """Draw the tracks side by side; false without matplotlib."""
    try:
        import matplotlib as mpl
    except ImportError:
        return False
    mpl.use("agg")
    from matplotlib import pyplot

    figure, axes = pyplot.subplots(1, len(tracks), figsize=(4 * len(tracks), 4), squeeze=False)
    for axis, (name, track) in zip(axes[0], tracks.items(), strict=True):
        xs, ys = [point[1] for point in track], [point[2] for point in track]
        axis.plot(xs, ys, linewidth=2)
        axis.plot(xs[:1], ys[:1], "o", label="begin")
        axis.plot(xs[-1:], ys[-1:], "s", color="black", label="end, with the heading")
        if track:
            heading = track[-1][3]
            arrow = {"head_width": 0.08, "length_includes_head": True, "color": "black", "zorder": 3}
            axis.arrow(xs[-1], ys[-1], 0.25 * math.cos(heading), 0.25 * math.sin(heading), **arrow)
        axis.set_title(name)
        axis.set_aspect("equal")
        axis.set_xlim(-0.2, 1.8)
        axis.set_ylim(-0.6, 1.0)
        axis.grid(True, alpha=0.3)
        axis.set_xlabel("x, m")
    axes[0][0].set_ylabel("y, m")
    axes[0][0].legend(loc="lower left", fontsize="small")
    figure.suptitle("One command, driven by each robot: 1 m, 45° to the left, 0.5 m, 180° about")
    figure.tight_layout()
    figure.savefig(output, dpi=120)
    pyplot.close(figure)
    return True
