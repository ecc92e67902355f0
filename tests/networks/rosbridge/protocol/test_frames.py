from __future__ import annotations

import json
import math
import time
from contextlib import suppress
from typing import Any

import cbor2
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway.errors import InvalidFrame
from ropeway.networks.rosbridge.protocol.frames import JsonAssembler, loads
from ropeway.types.untrusted import cbor_loads, json_loads, json_value

A = {"op": "publish", "topic": "/a", "msg": {"data": 'x"{}[]\\'}}
B: dict[str, Any] = {"op": "subscribe", "topic": "/b", "list": [1, -2.5, True, None, {}, [], "é"]}
TEXT_A, TEXT_B = json.dumps(A).encode(), json.dumps(B, ensure_ascii=False).encode()

HOSTILE = {
    "empty": (b"", True),
    "spaces": (b" \n", True),
    "a number": (b"5", True),
    "a truth value": (b"true", True),
    "null": (b"null", True),
    "a text": (b'"x"', True),
    "an array": (b'[{"op":"x"}]', True),
    "a word": (b"hello", True),
    "a broken word": (b'{"a":nul}', True),
    "invalid utf-8": (b'{"op":"\xff"}', True),
    "an overlong nul": (b'{"op":"\xc0\x80"}', True),
    "half a surrogate pair": (b'{"op":"\\ud800"}', True),
    "the other half": (b'{"op":"\\uDC00x"}', True),
    "deep arrays": (b'{"a":' + b"[" * 100_000 + b"]" * 100_000 + b"}", True),
    "deep objects": (b'{"a":' * 100_000 + b"1" + b"}" * 100_000, True),
    "deep and cut off": (b'{"a":' * 1_000_000, True),
    "many objects that are none": (b"{bad" * 1_000_000, True),
    "many arrays and cut off": (b'{"op":"x","a":[' + b"[1],[]," * 150_000, True),
    "many objects and cut off": (b'{"op":"x","a":[' + b'{"x":1,"y":[]},' * 150_000, True),
    "many nested arrays and cut off": (b'{"op":"x","a":[' + b"[[[[1]]]]," * 150_000, True),
    "many numbers and cut off": (b'{"op":"x","a":[' + b"1," * 1_000_000, True),
    "many words and cut off": (b'{"op":"x",' + b'"k":"v\\",' * 150_000, True),
    "just too deep": (b'{"a":' + b"[" * 128 + b"]" * 128 + b"}", True),
    "many digits": (b'{"a":' + b"9" * 10_000 + b"}", True),
    "cut off": (TEXT_A[:-1], True),
    "garbage behind": (TEXT_A + b" x", True),
    "garbage before": (b"x " + TEXT_A, True),
    "binary invalid utf-8": (b'{"op":"\xff"}', False),
    "binary neither": (b"\xff\xfe", False),
    "a CBOR array": (cbor2.dumps([A]), False),
    "a cut CBOR map": (cbor2.dumps(A)[:-1], False),
    "a CBOR map that claims 2^63 pairs": (bytes.fromhex("bb7fffffffffffffff"), False),
    "a CBOR array that claims 2^63": (bytes.fromhex("a16161 9b7fffffffffffffff"), False),
    "a CBOR byte string that claims 2^62": (bytes.fromhex("a16161 5b3fffffffffffffff"), False),
    "deep CBOR": (b"\xa1\x61a" + b"\x81" * 100_000 + b"\x00", False),
    "deep endless CBOR": (b"\xa1\x61a" + b"\x9f" * 100_000, False),
    "CBOR with bad utf-8": (b"\xa1\x61a\x62\xc3\x28", False),
    "a CBOR date": (b"\xa1\x61a\xc1\x00", False),
    "a CBOR big number": (b"\xa1\x61a\xc2\x41\x01", False),
    "a CBOR decimal": (b"\xa1\x61a\xc4\x82\x1a\x7f\xff\xff\xff\x01", False),
    "a CBOR cycle": (b"\xa1\x61a\xd8\x1c\x81\xd8\x1d\x00", False),
    "a CBOR regular expression": (b"\xa1\x61a\xd8\x23\x61(", False),
    "a CBOR mail": (b"\xa1\x61a\xd8\x24\x61x", False),
    "a CBOR break": (b"\xff", False),
}


@pytest.mark.parametrize("text", [True, False])
def test_a_frame_holds_objects(text: bool) -> None:
    """Text and binary frames may hold one JSON object or several, with or without space between."""
    assert loads(TEXT_A, text=text) == [A]
    assert loads(TEXT_A + TEXT_B, text=text) == [A, B]
    assert loads(b"\n" + TEXT_A + b" \r\n" + TEXT_B + b"\t", text=text) == [A, B]
    assert loads(memoryview(TEXT_A), text=text) == [A]
    assert loads(bytearray(TEXT_B), text=text) == [B]
    assert loads(TEXT_B.decode(), text=text) == [B]


def test_a_binary_frame_may_be_cbor() -> None:
    """A CBOR map is taken, with definite and indefinite lengths; typed arrays stay tagged."""
    value = {"op": "publish", "topic": "/t", "msg": {"a": cbor2.CBORTag(85, b"\0" * 8), "b": b"\xff", "c": math.inf}}
    assert loads(cbor2.dumps(value), text=False) == [value]
    assert loads(b"\xbf\x62op\x61x\xff", text=False) == [{"op": "x"}]


def test_numbers_that_are_none_are_taken() -> None:
    """NaN, Infinity and numbers beyond a double are floats, as Python's JSON writes and reads them."""
    (value,) = loads(b'{"op":"x","a":[NaN,Infinity,-Infinity,1e999],"b":18446744073709551615}', text=True)
    assert math.isnan(value["a"][0])
    assert value["a"][1:] == [math.inf, -math.inf, math.inf]
    assert value["b"] == 2**64 - 1


def test_ordinary_depth_is_no_problem() -> None:
    """Nesting up to the limit is taken, and brackets within texts do not count."""
    deep: dict[str, Any] = {"op": "x", "t": "[" * 1000}
    for _ in range(126):
        deep = {"op": deep, "t": "{" * 10}
    assert loads(json.dumps(deep), text=True) == [deep]
    assert loads(json.dumps(deep) + " " + json.dumps(deep), text=True) == [deep, deep]
    with pytest.raises(InvalidFrame, match="deep"):
        loads(json.dumps({"op": "x", "a": [deep]}), text=True)


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_frame_raises_invalid_frame_soon(name: str) -> None:
    """Whatever is wrong with a frame, InvalidFrame tells in a short text, in time proportional to its size."""
    data, text = HOSTILE[name]
    began = time.process_time()
    with pytest.raises(InvalidFrame) as caught:
        loads(data, text=text)
    assert time.process_time() - began < 2
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize("size", [1, 2, 3, 7, 50])
@pytest.mark.parametrize("text", [True, False])
def test_an_object_is_assembled_from_several_frames(size: int, text: bool) -> None:
    """Objects that are split anywhere, also within numbers, words and escapes, come out whole."""
    assembler = JsonAssembler()
    stream = TEXT_A + b' {"op":"x","n":[1.5e3,-Infinity,true,false,null,"\\u00e9\\\\"]}\n' + TEXT_B + TEXT_A
    found = []
    for at in range(0, len(stream), size):
        found += assembler.feed(stream[at : at + size], text=text)
    assert found == [A, {"op": "x", "n": [1500.0, -math.inf, True, False, None, "é\\"]}, B, A]
    assert assembler.pending_bytes == assembler.garbage_bytes == 0


def test_garbage_is_dropped_and_what_follows_is_processed() -> None:
    """What is no JSON is thrown away and counted; the objects around it come out."""
    assembler = JsonAssembler()
    for garbage in (b"hello ", b"{bad", b"{{{ ", b'{"op":"x",tru}', b"{}}", b'{"a" 1}', b'{"a":[}]', b"\xff\xfe "):
        before = assembler.garbage_bytes
        found = assembler.feed(garbage + TEXT_A + b" ", text=True)
        assert found[-1] == A, garbage
        assert assembler.pending_bytes == 0
        assert assembler.garbage_bytes > before
    with pytest.raises(InvalidFrame):
        assembler.feed(b"nothing of use", text=True)
    assert assembler.feed(TEXT_B, text=True) == [B]


def test_an_object_that_was_never_finished_does_not_swallow_the_next() -> None:
    """A frame that is an operation by itself is taken as one, whatever waited before."""
    assembler = JsonAssembler()
    assert assembler.feed(b'{"op":"publish","msg":{"data":"abc', text=True) == []
    assert assembler.pending_bytes == 34
    assert assembler.feed(TEXT_B, text=True) == [B]
    assert assembler.pending_bytes == 0
    assert assembler.garbage_bytes == 34
    assert assembler.feed(b'{"op":', text=True) == []
    assert assembler.feed(cbor2.dumps(A), text=False) == [A]
    assert assembler.feed(b'"x"}', text=True) == [{"op": "x"}]


def test_what_waits_is_bounded() -> None:
    """An object that does not end within the limit is given up, and the connection goes on."""
    assembler = JsonAssembler(limit_bytes=1000)
    assert assembler.feed(b'{"op":"' + b"x" * 900, text=True) == []
    with pytest.raises(InvalidFrame, match="1000"):
        assembler.feed(b"x" * 200, text=True)
    assert assembler.pending_bytes == 0
    assert assembler.feed(TEXT_A, text=True) == [A]


def test_small_pieces_cost_no_more_than_large_ones() -> None:
    """What was looked at is not looked at again, so that a slow sender cannot keep the processor busy."""
    assembler = JsonAssembler()
    began = time.process_time()
    for piece in [b'{"op":"x","t":"', *[b"y" * 64] * 20_000, b'","s":', *[b" " * 64] * 20_000, b"1}"]:
        found = assembler.feed(piece, text=True)
    assert [list(x) for x in found] == [["op", "t", "s"]]
    assert time.process_time() - began < 5


def test_a_long_path_may_come_in_pieces() -> None:
    """An object with very many ordinary parts is assembled."""
    pose = {"header": {"stamp": {"sec": 1, "nanosec": 2}}, "pose": {"position": {"x": 1.0}, "orientation": {"w": 1}}}
    message = {"op": "publish", "topic": "/path", "msg": {"poses": [pose] * 20_000}}
    data = json.dumps(message).encode()
    assembler = JsonAssembler()
    assert assembler.feed(data[:1_000_000], text=True) == []
    assert assembler.feed(data[1_000_000:], text=True) == [message]


def test_values_alone_are_read_too() -> None:
    """json_loads and cbor_loads take any value."""
    assert json_loads(b"[1,2]") == [1, 2]
    assert cbor_loads(b"\x82\x01\x02") == [1, 2]


FRAGMENTS = st.sampled_from(
    [TEXT_A, TEXT_B, TEXT_A[:20], TEXT_B[5:], b"{", b"}", b"[", b"]", b'"', b"\\", b":", b",", b"1", b"-", b"nul", b" "]
)


@settings(deadline=None)
@given(st.lists(st.lists(FRAGMENTS | st.binary(max_size=10), max_size=6).map(b"".join), max_size=6), st.booleans())
def test_only_invalid_frame_is_raised(frames: list[bytes], text: bool) -> None:
    """Whatever frames come, the assembler gives dicts or raises InvalidFrame, and keeps no more than came."""
    assembler = JsonAssembler()
    for frame in frames:
        with suppress(InvalidFrame):
            assert all(isinstance(found, dict) for found in assembler.feed(frame, text=text))
        with suppress(InvalidFrame):
            loads(frame, text=text)
    assert assembler.pending_bytes + assembler.garbage_bytes <= sum(map(len, frames))


@settings(deadline=None, max_examples=300)
@given(
    st.binary(max_size=40),
    st.sampled_from([b"", b"\xa1\x61a", b"\xa1\x61a\xd8", b"\xa1\x61a\xd9\x01", b"\xa2\x61a\xc5"]),
)
def test_only_invalid_frame_is_raised_for_cbor(data: bytes, start: bytes) -> None:
    """Whatever CBOR comes, with whatever tags, a dict comes out or InvalidFrame is raised."""
    with suppress(InvalidFrame):
        assert all(isinstance(found, dict) for found in loads(start + data, text=False))


OBJECTS = st.dictionaries(
    st.text(),
    st.recursive(
        st.none() | st.booleans() | st.integers(-(2**63), 2**64 - 1) | st.floats(allow_nan=False) | st.text(),
        lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(), inner, max_size=4),
        max_leaves=10,
    ),
)


@settings(deadline=None, max_examples=50)
@given(st.lists(OBJECTS, min_size=1, max_size=4), st.integers(1, 40), st.booleans())
def test_every_object_survives_being_cut(objects: list[dict[str, Any]], size: int, ascii: bool) -> None:
    """Any objects written one after the other and cut into pieces are read as they were."""
    stream = b"\n".join(json.dumps({**x, "op": "x"}, ensure_ascii=ascii).encode() for x in objects)
    assembler = JsonAssembler()
    found = []
    for at in range(0, len(stream), size):
        piece = stream[at : at + size]
        found += assembler.feed(piece, text=True)
    expected = [{**x, "op": "x"} for x in objects]
    if assembler.garbage_bytes == 0:  # a piece may look like an operation of its own
        assert found == expected


@pytest.mark.parametrize("text", ["[" * 5000, "[" * 200 + "]" * 200, "1" * 5000, "{", "", '"\\ud800"'])
def test_a_text_that_is_no_frame_raises_value_error(text: str) -> None:
    """What cannot be used is refused with one kind of error, also where Python's own parser overflows its stack."""
    with pytest.raises(ValueError, match=r"."):
        json_value(text)
    assert json_value('{"a": [1, 2.5, null]}') == {"a": [1, 2.5, None]}
