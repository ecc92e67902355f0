"""How much may be on the way at once, so that what is sent next is decided late.

TCP queues what it is given: in its own buffer, in the network device, in every router on the way. A message behind
such a queue is old before it leaves. Therefore only so much is handed to TCP as the link needs to stay busy: its pace
times its shortest round trip, and a little more. What the peer has not acknowledged yet is asked from the kernel. If
the pace rises with the window, the window grows; if only the queue grows, it does not. (The idea is that of delay
based congestion control such as TCP Vegas.)
"""

from __future__ import annotations

import contextlib
import fcntl
import socket
import struct
import termios
from typing import Any, Final, NamedTuple

__all__ = ["TcpInfo", "Window", "tcp_info"]

_TCP_INFO: Final = getattr(socket, "TCP_INFO", None)
_FIELDS: Final = struct.Struct("<16x I 48x I 56x Q 12x I")  # tcpi_snd_mss, _rtt, _bytes_received, _min_rtt
_INT: Final = struct.Struct("i")
_QUEUE_S: Final = 0.0015  # so much may wait on the way: timers have a resolution of 1 ms
_GAIN: Final = 1.25
_MIN_BYTES: Final = 8 * 1024
_MAX_BYTES: Final = 1 << 20  # a link that could use more is left to the kernel
_FIRST_BYTES: Final = 16 * 1024
_GROWTH: Final = 1.5
_LONGEST_RTT_S: Final = 1.0


class TcpInfo(NamedTuple):
    """What the kernel knows of a connection; ``segment_bytes`` is what one packet to the peer carries."""

    segment_bytes: int
    rtt_s: float
    min_rtt_s: float
    bytes_received: int


def tcp_info(sock: Any) -> TcpInfo | None:
    """The kernel's figures for a TCP socket, where it has them (Linux)."""
    if _TCP_INFO is None or sock is None:
        return None
    try:
        raw = sock.getsockopt(socket.IPPROTO_TCP, _TCP_INFO, _FIELDS.size)
    except OSError:
        return None
    if len(raw) < _FIELDS.size:
        return None
    segment, rtt, received, min_rtt = _FIELDS.unpack(raw)
    return TcpInfo(segment, rtt / 1e6, min_rtt / 1e6, received)


class Window:
    """The window of one TCP connection. ``limit`` is in bytes, ``None`` while the kernel decides."""

    def __init__(self, sock: Any) -> None:
        self._socket = sock
        self._fd = -1
        with contextlib.suppress(OSError, AttributeError):
            self._fd = sock.fileno()
        info = tcp_info(sock)
        segment = info.segment_bytes if info is not None else 0
        self.late_bytes = 2 * segment  # a receiver may acknowledge so much up to 40 ms late, however fast the link is
        self.limit: int | None = None
        if info is not None and self.outstanding() is not None:
            self.limit = max(_FIRST_BYTES, 2 * self.late_bytes)

    def outstanding(self) -> int | None:
        """Bytes handed to TCP that the peer has not acknowledged; ``None`` where the kernel does not tell."""
        try:
            return int(_INT.unpack(fcntl.ioctl(self._fd, termios.TIOCOUTQ, b"\0\0\0\0"))[0])
        except (OSError, ValueError):
            return None

    def fit(self, bytes_per_s: float) -> None:
        """Fit the window to a link of this pace."""
        info = tcp_info(self._socket)
        if info is None:
            self.limit = None
            return
        wanted = _GAIN * bytes_per_s * (min(info.min_rtt_s, _LONGEST_RTT_S) + _QUEUE_S)
        if self.limit is not None:
            wanted = min(wanted, _GROWTH * self.limit)  # a burst that passed at once is not yet a pace
        self.limit = None if wanted > _MAX_BYTES else int(max(wanted, _MIN_BYTES, 2 * self.late_bytes))

    def grow(self) -> None:
        """The link ran empty: allow more."""
        if self.limit is not None:
            wider = _GROWTH * self.limit
            self.limit = None if wider > _MAX_BYTES else int(wider)

    def release(self) -> None:
        """Leave it to the kernel: the link is fast."""
        self.limit = None
