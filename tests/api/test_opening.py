"""What is opened when somebody waits for it."""

from __future__ import annotations

from ropeway.api.opening import Opening


class Door:
    closed = False

    async def close(self) -> None:
        self.closed = True


async def made() -> Door:
    return Door()


async def test_await() -> None:
    """What is awaited stays open."""
    assert not (await Opening(made())).closed


async def test_block() -> None:
    """What is entered is closed at the end of the block."""
    async with Opening(made()) as door:
        assert not door.closed
    assert door.closed
