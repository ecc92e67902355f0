"""Socket buffers as small as the link allows, so that what is sent next is decided late.

TCP queues what it is given: in its own buffer, in the network device, in every router on the way. A message behind
such a queue is old before it leaves. The buffer is therefore fitted to the pace of the link and its shortest round
trip: a little more than what is on the way when nothing queues. If the round trip grows, the link queues, and the
buffer is smaller than what it would take; if it does not, the pace rises with the buffer. (The idea is that of delay
based congestion control such as TCP Vegas; the figures come from the kernel.)
"""

from __future__ import annotations

import contextlib
import socket
import struct
import time
from typing import Any, Final, NamedTuple

__all__ = ["Buffers", "TcpInfo", "tcp_info"]

_TCP_NOTSENT_LOWAT: Final = getattr(socket, "TCP_NOTSENT_LOWAT", 25)
_TCP_INFO: Final = getattr(socket, "TCP_INFO", None)
_SO_BUF_LOCK: Final = 72  # Linux 5.15: 0 gives a buffer back to the kernel's own tuning
_FIELDS: Final = struct.Struct("<68x I 56x Q 12x I")  # tcpi_rtt, tcpi_bytes_received, tcpi_min_rtt
_QUEUE_S: Final = 0.0025  # so much may wait on the way, to keep the link busy between two looks
_GAIN: Final = 1.25
_MIN_BYTES: Final = 16 * 1024
_MAX_BYTES: Final = 1 << 20  # a link that could use more is left to the kernel
_AHEAD_S: Final = 0.001
_EVERY_S: Final = 0.02
_OPEN_AHEAD_BYTES: Final = 128 * 1024


class TcpInfo(NamedTuple):
    """What the kernel knows of a connection."""

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
    rtt, received, min_rtt = _FIELDS.unpack(raw)
    return TcpInfo(rtt / 1e6, min_rtt / 1e6, received)


class Buffers:
    """The send buffer of one socket."""

    def __init__(self, sock: Any) -> None:
        self._socket = sock
        self._fitted_at = float("-inf")
        self._fitted = 0
        self._set(socket.IPPROTO_TCP, _TCP_NOTSENT_LOWAT, _OPEN_AHEAD_BYTES)

    def fit(self, bytes_per_s: float) -> None:
        """Fit the buffer to a link of this pace; costs nothing most of the time."""
        now = time.monotonic()
        if now - self._fitted_at < _EVERY_S:
            return
        self._fitted_at = now
        info = tcp_info(self._socket)
        if info is None:
            return
        wanted = int(max(_GAIN * bytes_per_s * (info.min_rtt_s + _QUEUE_S), _MIN_BYTES))
        if wanted > _MAX_BYTES:
            self.release()
        elif not 0.8 < wanted / max(self._fitted, 1) < 1.25:
            self._fitted = wanted
            self._set(socket.SOL_SOCKET, socket.SO_SNDBUF, wanted // 2)  # the kernel doubles it for its own needs
            self._set(socket.IPPROTO_TCP, _TCP_NOTSENT_LOWAT, int(max(bytes_per_s * _AHEAD_S, _MIN_BYTES // 2)))

    def release(self) -> None:
        """The link is fast: leave the buffer to the kernel."""
        if self._fitted:
            self._fitted = 0
            self._set(socket.SOL_SOCKET, _SO_BUF_LOCK, 0)
            self._set(socket.IPPROTO_TCP, _TCP_NOTSENT_LOWAT, _OPEN_AHEAD_BYTES)

    def _set(self, level: int, option: int, value: int) -> None:
        with contextlib.suppress(OSError, AttributeError):
            self._socket.setsockopt(level, option, value)
