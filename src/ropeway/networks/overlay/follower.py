"""Puts the messages of one publisher in order for one reader, and says which are missing. Sans-I/O."""

from __future__ import annotations

from collections.abc import Iterable

from ropeway.limits import OVERLAY_HELD_BYTES_PER_PUBLISHER, OVERLAY_HELD_MESSAGES
from ropeway.networks.overlay.held_bytes import HeldBytes
from ropeway.networks.overlay.packet_item import PacketItem

__all__ = ["Follower"]

_ITEM_BYTES = 256  # what a message costs beside its payload


class Follower:
    """Tracks what one reader has received of one publisher.

    ``reliable``: a gap is asked for before what comes after it is given. ``history``: so is what was published before.
    ``start`` is the number of the newest message when the reader came. ``missing`` is what to ask for now, as
    ``(after, upto)``, ``None`` if nothing: ask once, then call ``recovered`` or ``give_up``. What waits meanwhile is
    taken from the budget ``held``.
    """

    def __init__(self, *, reliable: bool, history: bool, start: int, held: HeldBytes | None = None) -> None:
        self.last = start
        self._budget = held or HeldBytes()
        self.lost = 0
        self.reliable = reliable
        self._held: list[PacketItem] = []
        self._held_bytes = 0
        self.missing: tuple[int, int | None] | None = None
        self.asked = False
        if history and start:
            self.last = 0
            self.missing = (0, None)

    def arrived(self, items: Iterable[PacketItem]) -> list[PacketItem]:
        """Take messages and return those that can be delivered now."""
        given: list[PacketItem] = []
        for item in items:
            if item.number <= self.last:
                continue  # had before
            if self.missing is not None and item.number == self.last + 1 and self.missing[1] is not None:
                self.last = item.number  # it only came late, by another way
                given.append(item)
                self._let_follow(given)
            elif self.missing is not None:
                self._hold(item, given)
            elif self.reliable and item.number > self.last + 1:
                self.missing = (self.last, item.number - 1)
                self._hold(item, given)
            else:
                self.last = item.number
                given.append(item)
        return given

    def told(self, newest: int) -> None:
        """Take the number of the publisher's newest message."""
        if self.reliable and newest > self.last and self.missing is None:
            self.missing = (self.last, newest)

    def recovered(self, items: Iterable[PacketItem]) -> list[PacketItem]:
        """Take the answer to ``missing`` and return the samples that can be delivered now. What did not come
        is lost.
        """
        asked, self.missing, self.asked = self.missing, None, False
        held = self._held
        self.forget()
        given: list[PacketItem] = []
        for item in sorted([*items, *held], key=_number):
            if item.number <= self.last:
                continue
            if asked is not None and asked[1] is not None:
                self.lost += item.number - self.last - 1
            self.last = item.number
            given.append(item)
        if asked is not None and asked[1] is not None and asked[1] > self.last:
            self.lost += asked[1] - self.last
            self.last = asked[1]
        return given

    def give_up(self) -> list[PacketItem]:
        """Give up on the gap and return the buffered samples."""
        return self.recovered(())

    def forget(self) -> None:
        """Let go of what waits."""
        self._budget.give(self._held_bytes)
        self._held, self._held_bytes = [], 0

    def _let_follow(self, given: list[PacketItem]) -> None:
        """Give what waited for the message before it."""
        held = sorted(self._held, key=_number)
        count = 0
        for item in held:
            if item.number > self.last + 1:
                break
            if item.number > self.last:
                self.last = item.number
                given.append(item)
            size = len(item.payload) + _ITEM_BYTES
            self._budget.give(size)
            self._held_bytes -= size
            count += 1
        self._held = held[count:]

    def _hold(self, item: PacketItem, given: list[PacketItem]) -> None:
        size = len(item.payload) + _ITEM_BYTES
        room = self._budget.take(size)
        if room:
            self._held_bytes += size
        self._held.append(item)
        many = len(self._held) > OVERLAY_HELD_MESSAGES or self._held_bytes > OVERLAY_HELD_BYTES_PER_PUBLISHER
        if many or not room:
            given += self.give_up()


def _number(item: PacketItem) -> int:
    return item.number
