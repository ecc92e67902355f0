"""States the equations of Song & Choi 2024, section 4.4, and one for links that are shared by bytes.

All of them are about one link. Rates are per second, bandwidths in bits per second.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Final, NamedTuple

__all__ = [
    "DEFAULT_LZ4_RATIO",
    "Load",
    "bandwidth_bps",
    "gateway_bandwidth_bps",
    "received_rate_hz",
    "shared_rates_hz",
]

DEFAULT_LZ4_RATIO: Final = 2.101
"""The compression ratio of LZ4 that the paper uses for ``zip`` and ``rawzip``, where none was measured."""

_BITS_PER_BYTE: Final = 8


class Load(NamedTuple):
    """A topic as a link sees it.

    ``copies`` says how many copies of each message cross: with plain DDS one for every pair of a publisher and a
    reader on different hosts (the sum of Np * Ns), with gateways one for every pair of hosts (the sum of Ep * Es).
    ``ratio`` is the compression ratio.
    """

    size_bytes: float
    published_hz: float
    copies: int = 1
    ratio: float = 1.0

    @property
    def bandwidth_bps(self) -> float:
        """Bits per second that the topic asks for."""
        return self.size_bytes * self.published_hz * self.copies * _BITS_PER_BYTE / self.ratio


def bandwidth_bps(loads: Iterable[Load]) -> float:
    """Return B of equation (3): the bandwidth that topics ask of a link."""
    return sum(load.bandwidth_bps for load in loads)


def gateway_bandwidth_bps(loads: Iterable[Load], ratio: float) -> float:
    """Return B_g of equation (5): the bandwidth with gateways that compress all topics by one ratio Co."""
    return bandwidth_bps(load._replace(ratio=1.0) for load in loads) / ratio


def received_rate_hz(published_hz: float, link_bps: float, needed_bps: float) -> float:
    """Return Rr of equation (4): the rate at which a topic arrives, at most the rate at which it is published."""
    return published_hz if needed_bps <= link_bps else published_hz * link_bps / needed_bps


def shared_rates_hz(loads: Sequence[Load], link_bps: float) -> list[float]:
    """Return the rates at which topics arrive where they share the link by bytes, as gateways of Ropeway do.

    A topic that asks for less than an equal share gets all it asks for; the others share what is left.
    """
    rates = [0.0] * len(loads)
    left_bps = link_bps
    ascending = sorted(range(len(loads)), key=lambda index: loads[index].bandwidth_bps)
    for taken, index in enumerate(ascending):
        load = loads[index]
        share_bps = left_bps / (len(loads) - taken)
        rates[index] = received_rate_hz(load.published_hz, share_bps, load.bandwidth_bps)
        left_bps -= min(share_bps, load.bandwidth_bps)
    return rates
