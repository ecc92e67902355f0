"""Questions of a viewer that take a while: how many are under way, in which order they are answered."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Sequence
from typing import Any

from ropeway.limits import VIEWER_PARAMETERS_WATCHED, VIEWER_QUESTIONS
from ropeway.listener.authorization import Access
from ropeway.networks.foxglove.wire import GivenParameter
from tests.networks.foxglove.viewer import Sight
from tests.support.until import until


class SlowSource:
    """A source of parameters that answers when it is told to."""

    def __init__(self) -> None:
        self.asked: list[tuple[str, ...]] = []
        self.given: list[tuple[str, Any]] = []
        self.open = asyncio.Event()

    async def get(self, names: Sequence[str], access: Access, complain: Callable[[str], None]) -> list[dict[str, Any]]:
        """See ``ParameterSource.get``."""
        self.asked.append(tuple(names))
        await self.open.wait()
        return [{"name": name, "value": len(self.given)} for name in names]

    async def set(self, given: Sequence[GivenParameter], access: Access, complain: Callable[[str], None]) -> None:
        """See ``ParameterSource.set``."""
        self.given += [(parameter.name, parameter.value) for parameter in given]

    def may_read(self, name: str, access: Access) -> bool:
        """See ``ParameterSource.may_read``."""
        return name != "/n.secret"


async def test_in_order(sight: Sight) -> None:
    """Questions are answered one after the other, so that what is read after it was set has the new value."""
    source = sight.server.parameters = SlowSource()
    viewer = await sight.viewer()
    viewer.send({"op": "getParameters", "parameterNames": ["/n.a"], "id": "1"})
    viewer.send({"op": "setParameters", "parameters": [{"name": "/n.a", "value": 7}], "id": "2"})
    viewer.send({"op": "getParameters", "parameterNames": ["/n.a"], "id": "3"})
    await until(lambda: source.asked)
    await viewer.passed()
    assert (source.asked, source.given) == ([("/n.a",)], [])
    source.open.set()
    answers = [await viewer.op("parameterValues") for _ in range(3)]
    assert [(told["id"], told["parameters"][0]["value"]) for told in answers] == [("1", 0), ("2", 1), ("3", 1)]


async def test_no_more_than_the_limit(sight: Sight) -> None:
    """A question that is one too many is refused, as one for a file is, and those under way are answered."""
    source = sight.server.parameters = SlowSource()
    viewer = await sight.viewer()
    for number in range(VIEWER_QUESTIONS):
        viewer.send({"op": "getParameters", "parameterNames": ["/n.a"], "id": str(number)})
    viewer.send({"op": "getParameters", "parameterNames": ["/n.a"], "id": "late"})
    assert "are not answered yet" in await viewer.complaint()
    source.open.set()
    answers = [(await viewer.op("parameterValues"))["id"] for _ in range(VIEWER_QUESTIONS)]
    assert answers == [str(number) for number in range(VIEWER_QUESTIONS)]


async def test_watching(sight: Sight) -> None:
    """A viewer is told the newest value of what it watches and may read, and nothing after it stops."""
    sight.server.parameters = SlowSource()
    viewer = await sight.viewer()
    names = ["/n.a", "/n.secret"]
    viewer.send({"op": "subscribeParameterUpdates", "parameterNames": names})
    await viewer.passed()
    questions = sight.session.questions
    assert questions.watched == set(names)
    for value in (1, 2):
        questions.changed("/n.a", value)
    questions.changed("/n.secret", 3)
    questions.changed("/n.other", 4)
    questions.tell_changes()
    assert (await viewer.op("parameterValues"))["parameters"] == [{"name": "/n.a", "value": 2}]
    viewer.send({"op": "unsubscribeParameterUpdates", "parameterNames": names})
    await viewer.passed()
    questions.changed("/n.a", 5)
    questions.tell_changes()
    await viewer.passed()
    assert not [told for told in viewer.told if told["op"] == "parameterValues"]


async def test_too_much_to_watch(sight: Sight) -> None:
    """A viewer watches so many parameters and no more; those that it watches are kept."""
    viewer = await sight.viewer()
    half = VIEWER_PARAMETERS_WATCHED // 2 + 1
    for part in range(2):
        names = [f"/n.p{part}_{number}" for number in range(half)]
        for begin in range(0, half, 1000):
            viewer.send({"op": "subscribeParameterUpdates", "parameterNames": names[begin : begin + 1000]})
    assert "parameters at most" in await viewer.complaint()
    await viewer.passed()
    assert half <= len(sight.session.questions.watched) <= VIEWER_PARAMETERS_WATCHED


async def test_who_leaves(sight: Sight) -> None:
    """What is under way for a viewer that leaves is given up."""
    source = sight.server.parameters = SlowSource()
    viewer = await sight.viewer()
    viewer.send({"op": "getParameters", "parameterNames": []})
    await until(lambda: source.asked)
    questions = sight.session.questions
    viewer.abort()
    await until(lambda: not sight.server.sessions)
    assert (questions._chores.tasks, questions.watched) == (set(), set())
