"""Topics are measured: size, rate, and how far they can be compressed."""

from __future__ import annotations

import pytest

from ropeway.planning.measured import ENCODINGS, SAMPLED_MESSAGES, TopicSampler, compression_ratios
from ropeway.types import TypeRegistry

TYPE = "std_msgs/msg/String"


def test_size_and_rate() -> None:
    """The rate is that of the intervals, shared among the publishers; the size is the mean."""
    sampler = TopicSampler("/a", TYPE)
    for number in range(101):
        sampler.add(number * 10_000_000, bytes(100 + number % 2))
    topic = sampler.topic(None, {"robot": 2}, {"cloud": 1})
    assert topic is not None
    assert topic.published_hz == pytest.approx(50)
    assert topic.size_bytes == pytest.approx(100.5, abs=0.01)
    assert topic.ratios == {}


def test_too_few_messages() -> None:
    """One message has no rate."""
    sampler = TopicSampler("/a", TYPE)
    assert sampler.topic(None, {"robot": 1}, {"cloud": 1}) is None
    sampler.add(5, b"x")
    assert sampler.topic(None, {"robot": 1}, {"cloud": 1}) is None


def test_samples_are_bounded() -> None:
    """However long a topic is measured, few messages are kept, spread over the whole time."""
    sampler = TopicSampler("/a", TYPE)
    for number in range(10_000):
        sampler.add(number, number.to_bytes(4, "big"))
    kept = [int.from_bytes(raw, "big") for raw in sampler.kept]
    assert SAMPLED_MESSAGES <= len(kept) < 2 * SAMPLED_MESSAGES
    assert kept[0] == 0
    assert kept[-1] > 8000


def test_ratios_of_every_encoding() -> None:
    """Text compresses, CDR as it is has the ratio 1, and every encoding has a ratio."""
    codec = TypeRegistry().codec(TYPE)
    ratios = compression_ratios(codec, [codec.encode({"data": "tick " * 1000})] * 3)
    assert set(ratios) == set(ENCODINGS)
    assert ratios["cbor-raw"] == 1
    assert ratios["zstd"] > 50
    assert ratios["zip"] > 10
