"""Reads what the kernel knows of a TCP connection, and sets what it lets us set.

Everything here is Linux's ``TCP_INFO`` and a few socket options; where the system has none of them, nothing is known
and nothing happens.
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from typing import Any, Final, NamedTuple

from ropeway.delivery.pacing.rounds import LinkReading

__all__ = ["LOSSES_BORNE_S", "Tcp", "TcpInfo", "tcp_info"]

_TCP_INFO: Final = getattr(socket, "TCP_INFO", None)
# tcpi_snd_mss | unacked sacked lost retrans | rtt rttvar | total_retrans | bytes_acked bytes_received |
# notsent_bytes min_rtt | bytes_sent bytes_retrans
_FIELDS: Final = struct.Struct("<16x I 4x 4I 28x 2I 24x I 16x 2Q 8x 2I 48x 2Q")
_TCP_CONGESTION: Final = getattr(socket, "TCP_CONGESTION", None)
_SO_MAX_PACING_RATE: Final = 47
_RATE: Final = struct.Struct("@L")
_NO_PACING: Final = (1 << 8 * _RATE.size) - 1
_RETRANSMIT_OPTIONS: Final = (
    (45, 60_000),  # TCP_RTO_MIN_US: a round trip and 60 ms later, where 200 ms is usual
    (44, 1_000),  # TCP_RTO_MAX_MS: then every second at least, so that it goes soon after a cut has ended
)
_STEADY: Final = "cubic"  # is never in the way where nothing is lost, as we send less than it would
_LOSS_TOLERANT: Final = "bbr"  # takes no loss for a full link
LOSSES_BORNE_S: Final = 6.0
"""After so long ``bear_losses`` wants to be called again: every ten seconds what bears losses nearly stops for 0.2 s,
to see the shortest round trip, unless it has just begun."""


class TcpInfo(NamedTuple):
    """Figures of a connection; ``segment_bytes`` is what one packet to the peer carries."""

    segment_bytes: int
    unacknowledged: int
    selectively_acknowledged: int
    lost: int
    retransmitted: int
    rtt_s: float
    rtt_deviation_s: float
    retransmissions: int
    bytes_acknowledged: int
    bytes_received: int
    unsent_bytes: int
    min_rtt_s: float
    bytes_sent: int
    bytes_sent_again: int


def tcp_info(sock: Any) -> TcpInfo | None:
    """Return the kernel's figures for a TCP socket, ``None`` where it has none."""
    if _TCP_INFO is None or sock is None:
        return None
    try:
        raw = sock.getsockopt(socket.IPPROTO_TCP, _TCP_INFO, _FIELDS.size)
    except OSError:
        return None
    if len(raw) < _FIELDS.size:  # Linux 4.19 and later tell all of these
        return None
    (mss, unacked, sacked, lost, retrans, rtt, rttvar, total, acked, received, unsent, min_rtt, sent, again) = (
        _FIELDS.unpack(raw)
    )
    return TcpInfo(
        mss, unacked, sacked, lost, retrans, rtt / 1e6, rttvar / 1e6, total, acked, received, unsent, min_rtt / 1e6,
        sent, again,
    )  # fmt: skip


class Tcp:
    """A TCP socket as the model of its link needs it."""

    def __init__(self, sock: Any) -> None:
        self._socket = sock
        self._paced = _NO_PACING

    def read(self) -> LinkReading | None:
        """Read the figures that the model works with; ``None`` where the kernel does not tell them."""
        info = tcp_info(self._socket)
        if info is None:
            return None
        segment = info.segment_bytes
        # What is acknowledged selectively has arrived. What the kernel takes for lost may only be late: it counts.
        on_the_way = info.unacknowledged - info.selectively_acknowledged
        unacknowledged_bytes = info.bytes_sent - info.bytes_sent_again - info.bytes_acknowledged
        return LinkReading(
            time.monotonic(),
            info.bytes_acknowledged + info.selectively_acknowledged * segment,
            max(0, min(on_the_way * segment, unacknowledged_bytes)),
            info.unsent_bytes,
            info.rtt_s,
            info.rtt_deviation_s,
            info.retransmissions,
            segment,
        )

    def pace(self, bytes_per_s: float | None) -> None:
        """Make the kernel spread packets evenly at this rate, ``None`` for no limit."""
        wanted = _NO_PACING if bytes_per_s is None else min(int(bytes_per_s), _NO_PACING - 1)
        if wanted == self._paced or abs(wanted - self._paced) * 20 <= min(wanted, self._paced):  # within a twentieth
            return
        self._paced = wanted
        with contextlib.suppress(OSError, AttributeError):
            self._socket.setsockopt(socket.SOL_SOCKET, _SO_MAX_PACING_RATE, _RATE.pack(wanted))

    @property
    def congestion(self) -> str:
        """The congestion control in use, empty where the system does not tell."""
        if _TCP_CONGESTION is None:
            return ""
        try:
            raw: bytes = self._socket.getsockopt(socket.IPPROTO_TCP, _TCP_CONGESTION, 16)
        except (OSError, AttributeError):
            return ""
        return raw.split(b"\0", 1)[0].decode("ascii", "replace")

    def use_congestion(self, name: str) -> bool:
        """Switch to another congestion control; return whether the kernel has it."""
        if _TCP_CONGESTION is None:
            return False
        try:
            self._socket.setsockopt(socket.IPPROTO_TCP, _TCP_CONGESTION, name.encode())
        except (OSError, AttributeError):
            return False
        return True

    def retransmit_soon(self) -> None:
        """Send again soon what the peer does not acknowledge, where the kernel lets us say when."""
        for option, value in _RETRANSMIT_OPTIONS:
            with contextlib.suppress(OSError, AttributeError):
                self._socket.setsockopt(socket.IPPROTO_TCP, option, value)

    def stay_steady(self) -> None:
        """Use no congestion control that stops now and then: little is lost."""
        if self.congestion == _LOSS_TOLERANT:
            self.use_congestion(_STEADY)

    def start_again(self) -> None:
        """Let the congestion control forget the losses that it has seen, and grow as at the start."""
        name = self.congestion
        if name != _LOSS_TOLERANT and self.use_congestion(_LOSS_TOLERANT):  # which removes the threshold
            self.use_congestion(name)

    def bear_losses(self) -> None:
        """Begin with a congestion control that takes no loss for a full link, also where it is in use already."""
        self.stay_steady()
        self.use_congestion(_LOSS_TOLERANT)
