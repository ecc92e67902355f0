"""ropeway.listener.lockout: who guesses tokens is slowed down, then locked out."""

from __future__ import annotations

from ropeway.limits import ADDRESSES, FIRST_LOCKOUT_S, LONGEST_LOCKOUT_S, WRONG_TOKEN_S, WRONG_TOKENS
from ropeway.listener.lockout import Lockout


class Clock:
    def __init__(self) -> None:
        self.now = 1000.0

    def __call__(self) -> float:
        return self.now


def locked_out(lockout: Lockout, sender: str) -> int:
    """Guess until locked out; how many guesses that took."""
    guesses = 0
    while not lockout.locked_s(sender):
        lockout.wrong(sender)
        guesses += 1
    return guesses


def test_slows_down_and_locks_out() -> None:
    """Every wrong token delays the answer more; after too many, no token of that address is looked at for a while."""
    clock = Clock()
    lockout = Lockout(clock)
    delays = [lockout.wrong("10.0.0.7") for _ in range(WRONG_TOKENS - 1)]
    assert delays == sorted(delays)
    assert 0 < delays[0] < delays[-1] <= 1.0
    assert not lockout.locked_s("10.0.0.7")
    lockout.wrong("10.0.0.7")
    assert lockout.locked_s("10.0.0.7") == FIRST_LOCKOUT_S
    assert not lockout.locked_s("10.0.0.8")
    assert lockout.status() == {"wrong tokens": WRONG_TOKENS, "lockouts": 1, "locked out": 1}
    clock.now += FIRST_LOCKOUT_S
    assert not lockout.locked_s("10.0.0.7")


def test_each_lockout_is_longer() -> None:
    """Whoever goes on guessing is locked out for longer each time, up to a limit, until it has been quiet."""
    clock = Clock()
    lockout = Lockout(clock)
    times = []
    for _ in range(8):
        locked_out(lockout, "a")
        times.append(lockout.locked_s("a"))
        clock.now += times[-1]
    assert times[:3] == [FIRST_LOCKOUT_S, 2 * FIRST_LOCKOUT_S, 4 * FIRST_LOCKOUT_S]
    assert times[-1] == LONGEST_LOCKOUT_S
    clock.now += WRONG_TOKENS * WRONG_TOKEN_S
    assert locked_out(lockout, "a") == WRONG_TOKENS
    assert lockout.locked_s("a") == FIRST_LOCKOUT_S


def test_a_gateway_with_a_wrong_token() -> None:
    """Whoever tries no oftener than a gateway with a wrong token does is never locked out."""
    clock = Clock()
    lockout = Lockout(clock)
    for _ in range(10 * WRONG_TOKENS):
        lockout.wrong("a")
        assert not lockout.locked_s("a")
        clock.now += WRONG_TOKEN_S


def test_bounded() -> None:
    """However many addresses guess, only so many are remembered."""
    lockout = Lockout(Clock())
    for number in range(ADDRESSES + 10):
        lockout.wrong(str(number))
    assert len(lockout._records) == ADDRESSES
