"""Draws where the robots went, how they stand at the end, and what is mounted on them."""

from __future__ import annotations

import math
from pathlib import Path

from ropeway.cli.demo_robots.scene import Picture

__all__ = ["draw"]


def draw(picture: Picture, output: Path) -> bool:
    """Write the picture; return whether matplotlib is there."""
    try:
        import matplotlib as mpl
    except ImportError:
        return False
    mpl.use("agg")
    from matplotlib import pyplot

    figure, axis = pyplot.subplots(figsize=(8, 5.5))
    for name, track in picture.tracks.items():
        if not track:
            continue
        xs, ys = [pose[0] for pose in track], [pose[1] for pose in track]
        (line,) = axis.plot(xs, ys, linewidth=1.5, label=f"{name}/base_link")
        x, y, heading = track[-1]
        axis.plot([x], [y], "o", color=line.get_color(), markersize=9)
        for frame, ahead_m in picture.mounted[name].items():
            tip = x + ahead_m * math.cos(heading), y + ahead_m * math.sin(heading)
            axis.plot([x, tip[0]], [y, tip[1]], color=line.get_color(), linewidth=3)
            axis.annotate(f"{name}/{frame}", tip, textcoords="offset points", xytext=(4, 4), fontsize=7)
    axis.set(xlabel="x on the map, m", ylabel="y on the map, m", aspect="equal")
    axis.grid(True, alpha=0.3)
    axis.legend(loc="upper right", fontsize=8)
    figure.tight_layout()
    figure.savefig(output, dpi=120)
    pyplot.close(figure)
    return True
