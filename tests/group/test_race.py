"""ropeway.group.race: several are asked the same, and the first answer wins."""

from __future__ import annotations

import asyncio
from collections.abc import Mapping

import pytest

from ropeway.errors import CallFailed, NotServed, ProviderLost, RopewayError
from ropeway.group.race import Race

pytestmark = pytest.mark.jumping

Runner = tuple[float, "str | Exception"]
"""When a member answers, and with what."""


class Course:
    """Members that answer after a time; ``asked`` tells who was asked when, ``left`` who was told to stop."""

    def __init__(self, members: Mapping[str, Runner]) -> None:
        self.members = members
        self.asked: dict[str, float] = {}
        self.left: list[str] = []

    async def ask(self, name: str) -> str:
        loop = asyncio.get_running_loop()
        self.asked[name] = loop.time()
        seconds, answer = self.members[name]
        try:
            await asyncio.sleep(seconds)
        except asyncio.CancelledError:
            self.left.append(name)
            raise
        if isinstance(answer, Exception):
            raise answer
        return answer

    def race(self, *waiting: str, go_on: bool = True, errors: tuple[RopewayError, ...] = ()) -> Race[str]:
        return Race(self.ask, waiting, lambda error: go_on, errors)


async def test_the_first_in_time() -> None:
    """A member that answers in time is the only one that is asked."""
    course = Course({"a": (0.01, "of a"), "b": (0.0, "of b")})
    assert await course.race("b").run(["a"], 0.02) == "of a"
    await asyncio.sleep(0.1)
    assert list(course.asked) == ["a"]


async def test_a_late_first() -> None:
    """A second is asked when the first is late, and if it is sooner the first is told to stop."""
    course = Course({"a": (1.0, "of a"), "b": (0.01, "of b")})
    began_s = asyncio.get_running_loop().time()
    assert await course.race("b").run(["a"], 0.02) == "of b"
    assert asyncio.get_running_loop().time() - began_s == pytest.approx(0.03)
    assert course.left == ["a"]


async def test_a_late_first_that_is_sooner_all_the_same() -> None:
    """The first may answer while the second works, and the second is told to stop."""
    course = Course({"a": (0.05, "of a"), "b": (1.0, "of b")})
    assert await course.race("b").run(["a"], 0.02) == "of a"
    assert course.left == ["b"]


@pytest.mark.parametrize("after_s", [0.01, 0.02])
async def test_answers_in_one_turn(after_s: float) -> None:
    """Answers in the same turn are one answer, and the caller is not cancelled afterwards."""
    course = Course({"a": (0.02, "of a"), "b": (0.02 - after_s, "of b")})
    assert await course.race("b").run(["a"], after_s) in ("of a", "of b")
    await asyncio.sleep(1.0)


async def test_all_at_once() -> None:
    """Of several that are asked at once the first answer wins, and the others are told to stop."""
    course = Course({"a": (0.3, "of a"), "b": (0.1, "of b"), "c": (0.2, "of c")})
    assert await course.race().run(["a", "b", "c"]) == "of b"
    assert sorted(course.left) == ["a", "c"]


async def test_a_failure_waits_for_the_others() -> None:
    """A failure counts only when nobody else answers."""
    course = Course({"a": (0.01, ProviderLost("/x", "it died")), "b": (0.2, "of b")})
    assert await course.race().run(["a", "b"]) == "of b"


async def test_the_next_after_a_failure() -> None:
    """The next is asked after a failure where it may be, and not where it may not."""
    lost = ProviderLost("/x", "it died")
    course = Course({"a": (0.01, lost), "b": (0.01, "of b")})
    assert await course.race("b").run(["a"]) == "of b"
    course = Course({"a": (0.01, lost), "b": (0.01, "of b")})
    with pytest.raises(ProviderLost):
        await course.race("b", go_on=False).run(["a"])
    assert "b" not in course.asked


async def test_the_failure_that_says_most() -> None:
    """Of several failures that of a provider is told, rather than that nobody serves it."""
    course = Course({"a": (0.01, CallFailed("/x", "too heavy")), "b": (0.02, NotServed("/x"))})
    with pytest.raises(CallFailed, match="too heavy"):
        await course.race("b", errors=(NotServed("/x"),)).run(["a"])


async def test_a_fault_of_ours_is_not_hidden() -> None:
    """An error that is none of a call's comes out at once, whoever raised it."""
    course = Course({"a": (1.0, "of a"), "b": (0.01, ZeroDivisionError())})
    with pytest.raises(ZeroDivisionError):
        await course.race().run(["a", "b"])


async def test_a_caller_that_gives_up() -> None:
    """A cancelled caller leaves nobody at work."""
    course = Course({"a": (1.0, "of a"), "b": (1.0, "of b")})
    task = asyncio.create_task(course.race().run(["a", "b"]))
    await asyncio.sleep(0.01)
    task.cancel()
    with pytest.raises(asyncio.CancelledError):
        await task
    assert sorted(course.left) == ["a", "b"]
