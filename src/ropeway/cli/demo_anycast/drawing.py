"""Draws the latency of every frame over time, by machine, with the changes and the slow time marked."""

from __future__ import annotations

from pathlib import Path

from ropeway.cli.demo_anycast.scene import BOUND_S, LINKS_S, Story

__all__ = ["draw"]


def draw(story: Story, output: Path) -> bool:
    """Write the picture; return whether matplotlib is there."""
    try:
        import matplotlib as mpl
    except ImportError:
        return False
    mpl.use("agg")
    from matplotlib import pyplot

    figure, axis = pyplot.subplots(figsize=(9, 4))
    axis.axvspan(*story.slow_s, color="0.9", label=f"link to {story.slowed} is slow")
    axis.axhline(1e3 * BOUND_S, color="0.5", linestyle="--", linewidth=1, label="bound")
    for name in LINKS_S:
        mine = [(story.sent_s[n], 1e3 * late_s) for n, (late_s, who) in sorted(story.answers.items()) if who == name]
        if mine:
            axis.plot(*zip(*mine, strict=True), ".", markersize=4, label=name)
    for at_s, name, _ in story.changes:
        axis.axvline(at_s, color="tab:red", linewidth=1)
        above = axis.get_xaxis_transform()  # seconds, and parts of the height
        axis.text(at_s, 1.01, name, transform=above, rotation=45, va="bottom", ha="left", fontsize=8)
    axis.set(xlabel="s", ylabel="latency of the answer in ms")
    axis.legend(loc="upper left", bbox_to_anchor=(1.01, 1.0), fontsize=8)
    figure.savefig(output, dpi=120, bbox_inches="tight")
    pyplot.close(figure)
    return True
