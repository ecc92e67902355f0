"""What is opened when somebody waits for it."""

from __future__ import annotations

import pytest

from ropeway.api.opening import Closing, Opening


class Door(Closing):
    closed = False

    async def close(self) -> None:
        self.closed = True


async def made() -> Door:
    return Door()


async def test_await() -> None:
    """What is awaited stays open."""
    assert not (await Opening(made())).closed


@pytest.mark.parametrize("first", [False, True])
async def test_block(first: bool) -> None:
    """What is entered, before or after it was opened, is closed at the end of the block."""
    async with await Opening(made()) if first else Opening(made()) as door:
        assert not door.closed
    assert door.closed


async def test_mistakes() -> None:
    """Who forgets to wait for it, or enters it as a block without asyncio, is told what to write."""
    opening = Opening(made())
    with pytest.raises(AttributeError, match=r"has no 'closed': await it first"):
        opening.closed  # type: ignore[attr-defined]  # noqa: B018
    with pytest.raises(TypeError, match=r"write 'async with', or use ropeway\.blocking"), opening:
        pass
