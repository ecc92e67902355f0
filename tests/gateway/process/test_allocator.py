"""ropeway.gateway.process.allocator: memory that is free goes back to the system when much of it may be."""

from __future__ import annotations

from ropeway.budget import LARGE_BYTES, Budget
from ropeway.gateway.process.allocator import FreedMemory
from tests.support.until import until


async def test_after_a_large_connection() -> None:
    """Freed memory is given back once after connections for which much was held have ended, and after no other."""
    budget, freed = Budget(), FreedMemory(pause_s=0.0)
    budget.on_large_end = freed.due
    for most in (1000, LARGE_BYTES, 2 * LARGE_BYTES, 5):
        account, held = budget.open(lambda _: None), bytearray(most)
        account.hold("what it does not read", held.__len__)
        account.look()
        held.clear()
        account.look()
        account.close()
    await until(lambda: freed.given_back == 1)
    freed.due()
    freed.close()
    freed.due()
    await until(lambda: freed.given_back == 2)
