"""Decides when a connection may send: while its link has room, and the operating system accepts data."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, Final

from ropeway.delivery.pacing.model import LinkModel
from ropeway.delivery.pacing.tcp import Tcp

__all__ = ["Flow"]

_WATCHED_BYTES: Final = 16 * 1024  # so much on the way shows the pace of the link, if we look at it
_SHORTEST_WATCH_S: Final = 0.001
_LONGEST_WATCH_S: Final = 0.01
_LOOKS_PER_ROUND_TRIP: Final = 8
_PACING_ROUND_TRIP_S: Final = 0.002  # nearer, bursts cost no other topic anything
_PACING_LIMIT: Final = 50e6  # bytes per second: faster links swallow bursts


class Flow:
    """The flow of one connection, from ``open`` to ``close``.

    ``free`` tells whether to send; ``on_free`` is called when it is true again.
    """

    def __init__(self, on_free: Callable[[], None]) -> None:
        self.model = LinkModel()
        self.pace = self.model.pace
        self.free = False
        self._on_free = on_free
        self._open = False
        self._tcp: Tcp | None = None
        self._full = False  # the operating system takes no more
        self._held = False  # the link has no room
        self._bears_losses = False
        self._look: asyncio.TimerHandle | None = None

    @property
    def known(self) -> bool:
        """Whether the operating system tells how much is in flight."""
        return self._tcp is not None

    def open(self, sock: Any) -> None:
        """Begin to send on a connected socket."""
        self._open = True
        self.free = not self._full
        tcp = Tcp(sock)
        tcp.retransmit_soon()
        reading = tcp.read()
        if reading is not None:
            self._tcp = tcp
            tcp.stay_steady()
            self.model.observe(reading)

    def close(self) -> None:
        """End: nothing is sent any more."""
        self._open = self.free = False
        self._tcp = None
        if self._look is not None:
            self._look.cancel()
            self._look = None

    def sent(self, size_bytes: int) -> None:
        """Note what was handed to the transport, and stop sending if the link has no room for more."""
        if self._tcp is None:
            return
        model = self.model
        model.handed(size_bytes)
        if model.room_bytes <= 0 and not self._held:
            self._read()
            if model.room_bytes <= 0:
                self._held = True
                self.free = False
        if self._look is None and (self._held or model.outstanding_bytes >= _WATCHED_BYTES):
            self._watch()

    def full(self) -> None:
        """Stop sending: the operating system did not take everything."""
        self._full = True
        self.free = False

    def drained(self) -> None:
        """Resume: the operating system took everything."""
        self._full = False
        self._go_on()

    def _go_on(self) -> None:
        if self._open and not self._full and not self._held and not self.free:
            self.free = True
            self._on_free()

    def _watch(self) -> None:
        """Poll again soon, while sending is held or enough is in flight to show the pace."""
        if self._look is not None or not (self._held or self.model.outstanding_bytes >= _WATCHED_BYTES):
            return
        if self._held:
            seconds = self.model.look_in_s
        else:
            rtt = self.model.base_rtt_s or 0.0
            seconds = min(max(rtt / _LOOKS_PER_ROUND_TRIP, _SHORTEST_WATCH_S), _LONGEST_WATCH_S)
        self._look = asyncio.get_running_loop().call_later(seconds, self._look_again)

    def _look_again(self) -> None:
        self._look = None
        if self._tcp is None:
            return
        self._read()
        if self._held and self.model.room_bytes > 0:
            self._held = False
            self._go_on()
        self._watch()

    def _read(self) -> None:
        tcp, model = self._tcp, self.model
        assert tcp is not None
        reading = tcp.read()
        if reading is None:  # the socket is gone
            model.room_bytes = 1 << 30
            return
        model.observe(reading)
        pace = model.wanted_bps
        if pace is not None:
            spread = not model.starting and pace < _PACING_LIMIT and (model.base_rtt_s or 0.0) >= _PACING_ROUND_TRIP_S
            tcp.pace(model.spread_gain * pace if spread else None)
        if model.losing and not self._bears_losses:
            self._bears_losses = True
            tcp.bear_losses()
        elif model.squeezed():
            tcp.start_again()
