from __future__ import annotations

import json
from contextlib import suppress
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import InvalidOperation
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.protocol.fragment import MIN_FRAGMENT_SIZE, Defragmenter, Fragmenter

TEXT = ops.dumps({"op": "publish", "topic": "/t", "msg": {"data": 'é"\\' * 100}})


def fragments(frames: list[bytes]) -> list[ops.Fragment]:
    """The operations that frames hold."""
    parsed = [ops.parse(json.loads(frame)) for frame in frames]
    assert all(isinstance(op, ops.Fragment) for op in parsed)
    return parsed  # type: ignore[return-value]


def fragment(num: int, total: int, data: str = "x", id: Any = "1") -> ops.Fragment:
    """A fragment."""
    return ops.Fragment(id=id, data=data, num=num, total=total)


class Clock:
    """Seconds, set by hand."""

    now = 0.0

    def __call__(self) -> float:
        return self.now


def test_short_texts_stay_whole() -> None:
    """A text within the size, or without one, is one frame as it is."""
    assert Fragmenter().split(TEXT, None) == [TEXT]
    assert Fragmenter().split(TEXT, len(TEXT)) == [TEXT]
    assert Fragmenter().split(TEXT, 2147483647) == [TEXT]


def test_long_texts_are_split() -> None:
    """Fragments are numbered, know their total, share an id of their own and hold the text in order."""
    fragmenter = Fragmenter()
    first, second = (fragments(fragmenter.split(TEXT, 100)) for _ in range(2))
    assert [f.num for f in first] == list(range(len(first)))
    assert {f.total for f in first} == {len(first)} == {-(-len(TEXT) // 100)}
    assert {f.id for f in first} != {f.id for f in second}
    assert all(f.id and len(f.data) <= 100 for f in first)
    assert "".join(f.data for f in first).encode() == TEXT


def test_fragments_have_a_least_size() -> None:
    """A client cannot ask for so small fragments that a message becomes thousands of frames."""
    for size in (0, 1, MIN_FRAGMENT_SIZE):
        assert len(Fragmenter().split(TEXT, size)) == -(-len(TEXT) // MIN_FRAGMENT_SIZE)


@given(st.randoms(use_true_random=False), st.integers(32, 300))
def test_fragments_come_together_in_any_order(random: Any, size: int) -> None:
    """Fragments of several texts, mixed and repeated, give each text once and leave nothing behind."""
    fragmenter, defragmenter = Fragmenter(), Defragmenter()
    texts = [TEXT, TEXT + b"2", b"[" * 500]
    mixed = [f for text in texts for f in fragments(fragmenter.split(text, size))]
    random.shuffle(mixed)
    found = []
    for index, one in enumerate(mixed):
        text = defragmenter.add(one)
        if text is not None:
            found.append(text)
        elif index % 3 == 0:
            assert defragmenter.add(one) is None
    assert sorted(found) == sorted(texts)
    assert defragmenter.pending == defragmenter.pending_bytes == defragmenter.forgotten == 0


def test_ids_may_be_any_json() -> None:
    """Ids that differ only in kind are different texts."""
    defragmenter = Defragmenter()
    for id in (0, "0", 0.5, [0], {"a": 0}, False, 2**70):
        assert defragmenter.add(fragment(0, 2, str(id), id)) is None
    for id in (0, "0", 0.5, [0], {"a": 0}, False, 2**70):
        assert defragmenter.add(fragment(1, 2, "!", id)) == f"{id}!".encode()


def test_contradictions_are_refused() -> None:
    """Another total, a number beyond it, or other data under one number gives the text up, with rosbridge's text."""
    for wrong in (fragment(1, 3), fragment(0, 2, "y"), fragment(2, 2), fragment(-1, 2)):
        defragmenter = Defragmenter()
        assert defragmenter.add(fragment(0, 2)) is None
        with pytest.raises(InvalidOperation, match=f"error while trying to append fragment {wrong.num}") as caught:
            defragmenter.add(wrong)
        assert caught.value.id == "1"
        assert defragmenter.pending_bytes == 0
        assert defragmenter.forgotten == 1
        assert defragmenter.add(fragment(1, 2)) is None  # what still comes of it is not kept


def test_what_waits_is_bounded() -> None:
    """Bytes, fragments of a text and texts have limits; other texts go on."""
    defragmenter = Defragmenter(limit_bytes=100, limit_fragments=10, limit_texts=3)
    assert defragmenter.add(fragment(0, 2, "x" * 60, "a")) is None
    with pytest.raises(InvalidOperation, match="received invalid fragment!"):
        defragmenter.add(fragment(0, 2, "x" * 60, "b"))
    with pytest.raises(InvalidOperation, match="received invalid fragment!"):
        defragmenter.add(fragment(0, 11, "x", "c"))
    assert defragmenter.add(fragment(1, 2, "y", "a")) == b"x" * 60 + b"y"
    for id in "defg":
        defragmenter.add(fragment(0, 2, "x", id))
    assert defragmenter.pending == 3
    assert defragmenter.add(fragment(1, 2, "x", "d")) is None  # the oldest was forgotten
    assert defragmenter.pending_bytes == 3


def test_what_waits_too_long_is_forgotten() -> None:
    """A text that is not complete in time makes room at the next fragment, or when asked."""
    clock = Clock()
    defragmenter = Defragmenter(timeout_s=10, clock=clock)
    defragmenter.add(fragment(0, 2, "x", "a"))
    clock.now = 9
    defragmenter.add(fragment(0, 2, "y", "b"))
    clock.now = 11
    assert defragmenter.add(fragment(1, 2, "x", "a")) is None
    assert defragmenter.add(fragment(1, 2, "y", "b")) == b"yy"
    assert defragmenter.forgotten == 1
    clock.now = 100
    defragmenter.expire()
    assert defragmenter.pending == defragmenter.pending_bytes == 0


@given(
    st.lists(
        st.builds(
            fragment, st.integers(-1, 4), st.integers(0, 5), st.text(max_size=3), st.sampled_from(["1", 1, None, []])
        ),
        max_size=30,
    )
)
def test_only_invalid_operation_is_raised(sent: list[ops.Fragment]) -> None:
    """Whatever fragments come, texts come out or InvalidOperation is raised, and the account stays right."""
    defragmenter = Defragmenter(limit_bytes=20, limit_fragments=4, limit_texts=2)
    for one in sent:
        with suppress(InvalidOperation):
            text = defragmenter.add(one)
            assert text is None or isinstance(text, bytes)
        assert 0 <= defragmenter.pending_bytes <= 20
        assert defragmenter.pending <= 2
        if not defragmenter.pending:
            assert defragmenter.pending_bytes == 0
