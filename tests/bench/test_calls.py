"""bench.calls: what a message, a service call and a goal cost, counted."""

from __future__ import annotations

from typing import Final

from bench.calls import measure

from tests.support.ports import free_port

_SAMPLES: Final = 10
_MOST: Final = {
    "publish: DDS reader to socket": 20,
    "publish: socket to DDS writer": 10,
    "subscribe: DDS reader to socket": 19,
    "subscribe: socket to DDS writer": 10,
    "reserve-service: there and back": 143,
    "expose-service: there and back": 137,
    "reserve-action: there and back": 491,
    "expose-action: there and back": 462,
}


async def test_messages_calls_and_goals_cost_no_more_python_calls_than_they_did() -> None:
    """A warm message, a call with its answer and a goal with its result take no more Python calls than they did."""
    counts = await measure(samples=_SAMPLES, port=free_port())
    found = {count.way: [call for call in count.calls if "aio310.py" not in call] for count in counts}  # of 3.10 alone
    longer = ["\n".join((way, *calls)) for way, calls in found.items() if len(calls) > _MOST[way]]
    assert found.keys() == _MOST.keys()
    assert not longer, "\n\n".join(longer)
