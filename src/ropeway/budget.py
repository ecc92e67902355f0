"""Bounds the memory that peers make us hold, per connection and for the whole process.

Everything that keeps bytes for a connection (unfinished messages, queues, answers not read yet, definitions) registers
with the connection's ``Account`` a function that returns how many it keeps. Nothing is counted on the way of a message;
the sums are taken once enough was received to change them, and about once a second.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from typing import Any, Final

__all__ = ["ACCOUNT_BYTES", "LARGE_BYTES", "PROCESS_BYTES", "Account", "Budget"]

ACCOUNT_BYTES: Final = 128 << 20
"""The memory held for one connection at most: twice the largest message, as one arrives while another waits."""
PROCESS_BYTES: Final = 512 << 20
"""The memory held for all connections at most: a small robot has 2 to 4 GiB, which others need as well."""

LARGE_BYTES: Final = 8 << 20
"""The most that a connection held, from which on its end leaves enough free memory to be worth a word."""

_LOOK_BYTES: Final = 256 << 10  # received; less cannot change much


class Budget:
    """Keeps all accounts of one process. ``ended`` counts the connections that were closed, by reason."""

    def __init__(self, *, limit_bytes: int = PROCESS_BYTES, account_limit_bytes: int = ACCOUNT_BYTES) -> None:
        self.limit_bytes, self.account_limit_bytes = limit_bytes, account_limit_bytes
        self.held_bytes = 0
        self.ended: Counter[str] = Counter()
        self.on_large_end: Callable[[], None] = _nothing
        self._accounts: set[Account] = set()

    def open(self, end: Callable[[str], None]) -> Account:
        """Return the account of a new connection; ``end`` is called with the reason if it holds too much."""
        return Account(self, end)

    @property
    def full(self) -> str:
        """Return why nobody else may connect now; ``""`` while there is room."""
        if self.held_bytes < self.limit_bytes:
            return ""
        held, limit = _mib(self.held_bytes), _mib(self.limit_bytes)
        return f"the gateway holds {held} for those who are connected, and may hold {limit}"

    def status(self) -> dict[str, Any]:
        """Return the figures as JSON."""
        return {"held_bytes": self.held_bytes, "limit_bytes": self.limit_bytes, "ended": dict(self.ended)}

    def _changed(self, account: Account, by: int) -> None:
        self._accounts.add(account)
        self.held_bytes += by
        if account.held_bytes > self.account_limit_bytes:
            self._end(account, "connection", f"and may hold {_mib(self.account_limit_bytes)}")
        while self.held_bytes > self.limit_bytes and (most := max(self._accounts, key=_held, default=None)) is not None:
            self._end(most, "process", f"the most of all, which may hold {_mib(self.limit_bytes)} together")

    def _end(self, account: Account, limit: str, why: str) -> None:
        self.ended[limit] += 1
        what, held = account.most()
        reason = f"{_mib(account.held_bytes)} are held for this connection ({what}: {_mib(held)}), {why}"
        account.close()
        account.end(reason)

    def _forget(self, account: Account) -> None:
        self._accounts.discard(account)
        self.held_bytes -= account.held_bytes
        if account.most_bytes >= LARGE_BYTES:
            self.on_large_end()


class Account:
    """The bytes held for one connection, as of the last check."""

    __slots__ = ("_budget", "_holders", "_open", "end", "held_bytes", "look_at_bytes", "most_bytes")

    def __init__(self, budget: Budget, end: Callable[[str], None]) -> None:
        self._budget, self.end = budget, end
        self._holders: dict[str, Callable[[], int]] = {}
        self.look_at_bytes = _LOOK_BYTES  # received; with less, ``received`` need not be called
        self._open = True
        self.held_bytes = self.most_bytes = 0

    def hold(self, what: str, count: Callable[[], int]) -> None:
        """Enter something that keeps bytes; ``count`` returns how many it keeps now."""
        self._holders[what] = count

    def received(self, total_bytes: int) -> None:
        """Check again if enough was received since the last check to matter; ``total_bytes`` counts all that
        ever was.
        """
        if total_bytes >= self.look_at_bytes:
            self.look_at_bytes = total_bytes + _LOOK_BYTES
            self.look()

    def look(self) -> None:
        """Count what is held now; too much ends the connection."""
        if self._open:
            before, self.held_bytes = self.held_bytes, sum(count() for count in self._holders.values())
            self.most_bytes = max(self.most_bytes, self.held_bytes)
            self._budget._changed(self, self.held_bytes - before)

    def most(self) -> tuple[str, int]:
        """Return what holds the most, and how many bytes."""
        return max(((what, count()) for what, count in self._holders.items()), key=lambda row: row[1], default=("", 0))

    def close(self) -> None:
        """End the account: the connection is gone, or going."""
        if self._open:
            self._open = False
            self._budget._forget(self)
            self.held_bytes = 0
            self._holders.clear()


def _nothing() -> None:
    return None


def _held(account: Account) -> int:
    return account.held_bytes


def _mib(size: int) -> str:
    return f"{size / (1 << 20):.1f} MiB"
