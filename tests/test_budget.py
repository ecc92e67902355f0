"""ropeway.budget."""

from __future__ import annotations

from ropeway.budget import Account, Budget


class Holder:
    """A connection that holds so many bytes."""

    def __init__(self, budget: Budget, size: int = 0) -> None:
        self.size = size
        self.reasons: list[str] = []
        self.account: Account = budget.open(self.reasons.append)
        self.account.hold("queues", lambda: self.size)
        self.account.hold("fragments", lambda: self.size // 10)

    def holds(self, size: int) -> None:
        self.size = size
        self.account.look()


def test_sums() -> None:
    """The budget holds what all accounts hold, and nothing of those that were closed."""
    budget = Budget(limit_bytes=1000, account_limit_bytes=500)
    first, second = Holder(budget), Holder(budget)
    first.holds(100)
    second.holds(200)
    assert budget.held_bytes == 330
    first.holds(50)
    assert budget.held_bytes == 275
    second.account.close()
    assert budget.held_bytes == 55
    second.holds(400)
    assert budget.held_bytes == 55
    first.account.close()
    first.account.close()
    assert budget.held_bytes == 0


def test_one_holds_too_much() -> None:
    """A connection that holds more than it may is ended once, with the figures and what holds the most."""
    budget = Budget(limit_bytes=100 << 20, account_limit_bytes=10 << 20)
    greedy, modest = Holder(budget), Holder(budget)
    modest.holds(1 << 20)
    greedy.holds(10 << 20)
    greedy.holds(20 << 20)
    (reason,) = greedy.reasons
    assert "11.0 MiB are held for this connection (queues: 10.0 MiB)" in reason
    assert "10.0 MiB" in reason
    assert not modest.reasons
    assert budget.ended == {"connection": 1}
    assert budget.held_bytes < 2 << 20


def test_all_hold_too_much() -> None:
    """Where all together hold more than they may, nobody else may come, and who holds the most is ended."""
    budget = Budget(limit_bytes=1000, account_limit_bytes=900)
    holders = [Holder(budget) for _ in range(4)]
    for holder, size in zip(holders, (100, 400, 300, 100), strict=True):
        holder.holds(size)
    assert not budget.full
    assert not any(holder.reasons for holder in holders)
    holders[3].holds(200)
    assert [len(holder.reasons) for holder in holders] == [0, 1, 0, 0]
    assert budget.held_bytes == 660
    holders[0].holds(405)
    assert [len(holder.reasons) for holder in holders] == [0, 1, 0, 0]
    budget.limit_bytes = 990
    assert "0.0 MiB" in budget.full


def test_looks_when_much_came() -> None:
    """What came is counted once it is much, not for each frame."""
    budget = Budget()
    holder = Holder(budget)
    looks = []
    holder.account.hold("looks", lambda: looks.append(1) or 0)
    for total in range(0, 1 << 20, 1 << 10):
        holder.account.received(total)
    assert len(looks) == 3


def test_connections_that_never_stood() -> None:
    """An account that was opened and never looked at leaves nothing behind."""
    budget = Budget()
    for _ in range(10):
        Holder(budget)
    assert budget.status() == {"held_bytes": 0, "limit_bytes": budget.limit_bytes, "ended": {}}
    assert not budget._accounts
