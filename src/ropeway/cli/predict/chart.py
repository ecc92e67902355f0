"""Draws predicted rates: a group of bars per topic, a bar per encoding, as parts of what is published."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Final

from ropeway.planning.prediction import Prediction

__all__ = ["draw"]

_BAR_INCHES: Final = 0.13


def draw(rows: Sequence[Prediction], output: Path) -> bool:
    """Draw the rates to a PNG file, a picture per way; return false without matplotlib."""
    try:
        import matplotlib as mpl
    except ImportError:
        return False
    mpl.use("agg")
    from matplotlib import pyplot

    ways = list(dict.fromkeys(row.way for row in rows))
    encodings = list(dict.fromkeys(row.encoding for row in rows))
    topics_of = {way: list(dict.fromkeys(row.topic for row in rows if row.way == way)) for way in ways}
    heights = [1.0 + _BAR_INCHES * (len(encodings) + 1) * len(topics) for topics in topics_of.values()]
    figure, axes = pyplot.subplots(
        len(ways), 1, figsize=(9, sum(heights)), squeeze=False, gridspec_kw={"height_ratios": heights}
    )
    width = 0.85 / len(encodings)
    for axis, (way, topics) in zip(axes[:, 0], topics_of.items(), strict=True):
        found = {(row.topic, row.encoding): row for row in rows if row.way == way}
        for number, encoding in enumerate(encodings):
            parts = [100 * found[topic, encoding].shared_hz / found[topic, encoding].published_hz for topic in topics]
            places = [index - 0.425 + (number + 0.5) * width for index in range(len(topics))]
            bars = axis.barh(places, parts, width, label=encoding)
            axis.bar_label(bars, [f" {part:.0f} %" for part in parts], fontsize=6)
        names = [f"{topic}\n{found[topic, encodings[0]].published_hz:.3g} Hz" for topic in topics]
        axis.set_yticks(range(len(topics)), names, fontsize="small")
        axis.invert_yaxis()
        axis.set_xlim(0, 112)
        axis.set_xlabel("% of the rate at which the topic is published")
        axis.set_title(f"{way[0]} → {way[1]}, {found[topics[0], encodings[0]].rate_of_link_bps / 1e6:g} Mbit/s")
        axis.grid(visible=True, axis="x", alpha=0.3)
    handles, labels = axes[0, 0].get_legend_handles_labels()
    figure.legend(handles, labels, fontsize="small", ncols=len(encodings), loc="upper center")
    figure.tight_layout(rect=(0, 0, 1, 1 - 0.35 / sum(heights)))
    figure.savefig(output, dpi=120)
    pyplot.close(figure)
    return True
