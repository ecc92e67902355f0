"""ropeway.delivery.passage."""

from __future__ import annotations

from ropeway.delivery.outbox import Lost
from ropeway.delivery.passage import Passage
from ropeway.delivery.pipeline import Drop
from ropeway.graph.base import Sample


def sample(seq: int, payload: bytes = b"1234", *, stamp_ns: int = 0, sent_ns: int = 0) -> Sample:
    return Sample(payload, "a/msg/B", stamp_ns, b"", seq, sent_ns=sent_ns)


class LastValue:
    def __init__(self) -> None:
        self.kept: list[Sample] = []

    def put(self, sample: Sample) -> None:
        self.kept.append(sample)

    def last(self) -> Sample | None:
        return self.kept[-1] if self.kept else None


def test_messages_are_counted_kept_and_given_to_the_sink_in_their_order() -> None:
    """What passes is metered, kept and given to the sink, oldest first."""
    got: list[Sample] = []
    passage = Passage(keep=LastValue(), sink=got.append)
    batch = [sample(1), sample(2, b"123456", stamp_ns=50, sent_ns=20)]
    passage.pass_on(batch)
    meter, keep = passage.meter, passage.keep
    assert got == batch
    assert (meter.messages, meter.bytes, meter.delayed, meter.delay_ns) == (2, 10, 1, 30)
    assert keep is not None
    assert keep.last() is batch[1]
    assert not passage.drops


def test_every_drop_has_its_reason() -> None:
    """A message that a step drops is counted under its reason, reaches no later step and is not metered."""
    later: list[int] = []

    def odd(sample: Sample) -> Sample | Drop:
        return sample if sample.seq % 2 else Drop.RATE

    def small(sample: Sample) -> Sample | Lost:
        later.append(sample.seq)
        return sample if sample.seq < 4 else Lost.OVERFLOW

    got: list[Sample] = []
    passage = Passage((odd, small), sink=got.append)
    passage.pass_on([sample(i) for i in range(1, 7)])
    assert [s.seq for s in got] == [1, 3]
    assert later == [1, 3, 5]
    assert passage.drops == {Drop.RATE: 3, Lost.OVERFLOW: 1}
    assert passage.meter.messages == 2


def test_a_step_may_give_another_message() -> None:
    """What a step returns is what the next one, and the sink, get."""
    got: list[Sample] = []
    passage = Passage((lambda s: s.carrying(b"other"), lambda s: s), sink=got.append)
    passage.pass_on([sample(1)])
    assert [(s.seq, s.payload) for s in got] == [(1, b"other")]


def test_what_a_step_held_passes_no_step_again() -> None:
    """A message that a step holds is no drop, and passes on later without the steps."""
    held: list[Sample] = []
    got: list[Sample] = []
    passage = Passage((held.append,), sink=got.append)
    passage.pass_on([sample(1), sample(2)])
    assert not got
    assert not passage.drops
    passage.pass_on(held, held=True)
    assert [s.seq for s in got] == [1, 2]
    assert passage.meter.messages == 2


def test_without_a_sink_nobody_asked() -> None:
    """Without a sink messages are dropped as not asked for, and not metered."""
    passage = Passage()
    passage.pass_on([sample(1), sample(2)])
    assert passage.drops == {Drop.INACTIVE: 2}
    assert passage.meter.messages == 0


def test_the_status_adds_what_was_dropped_elsewhere() -> None:
    """The figures have the drops of the passage and those that the link tells, but none that did not happen."""
    passage = Passage()
    passage.pass_on([sample(1)])
    status = passage.status({Lost.REPLACED: 3, Lost.UNSENT: 0})
    assert status["drops"] == {Drop.INACTIVE.value: 1, Lost.REPLACED.value: 3}
    assert status["messages"] == 0
