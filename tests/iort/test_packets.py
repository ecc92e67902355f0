"""The packets of IoRT nodes and their parser."""

from __future__ import annotations

import ast
import subprocess
import sys
import tracemalloc
from pathlib import Path

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ropeway import iort
from ropeway.iort import Fault, Packet, Parser, escape, pack, unescape

CMD_VEL = b"%01/TURTLESIM/cmd_vel/p/0.0,0.0,0.0,0.0,0.0,0.0%"


def parse(data: bytes, **options: int) -> list[Packet | Fault]:
    return Parser(**options).feed(data)


def codes(found: list[Packet | Fault]) -> list[str]:
    return [item.code if isinstance(item, Fault) else item.op for item in found]


def test_plain() -> None:
    """The packets of the paper are read and written byte for byte, the form of its Alice included."""
    (packet,) = parse(CMD_VEL)
    assert packet == Packet("01", "TURTLESIM", "cmd_vel", "p", {}, b"0.0,0.0,0.0,0.0,0.0,0.0")
    assert len(CMD_VEL) == 48
    assert packet.encode() == CMD_VEL
    (packet,) = parse(b"%01/TURTLESIM/cmd_vel/s%")
    assert packet == Packet("01", "TURTLESIM", "cmd_vel", "s")
    assert packet.encode() == b"%01/TURTLESIM/cmd_vel/s%"
    (packet,) = parse(b"%01/ALICE/COS/NAVI_ROBOT_MOVE_REQl/p/stop%")
    assert packet == Packet("01", "ALICE", "NAVI_ROBOT_MOVE_REQl", "p", {}, b"stop", "COS")
    assert packet.encode() == b"%01/ALICE/COS/NAVI_ROBOT_MOVE_REQl/p/stop%"
    (packet,) = parse(b"%01/ALICE/COS/NAVI_ROBOT_MOVE_REQ/s%")
    assert packet == Packet("01", "ALICE", "NAVI_ROBOT_MOVE_REQ", "s", {}, b"", "COS")


def test_plain_data_is_left_alone() -> None:
    """Data of a plain packet may have slashes, tildes, quotes and line ends: nothing in it is an escape."""
    data = b'{"path": "a/b", "x": "~2 ~1 \\n"}\r\n'
    (packet,) = parse(b"%01/A/b/p/" + data + b"%")
    assert packet == Packet("01", "A", "b", "p", {}, data)


def test_several() -> None:
    """Packets may follow each other at once, or with line ends between."""
    assert codes(parse(CMD_VEL * 3)) == ["p"] * 3
    assert codes(parse(CMD_VEL + b"\r\n" + CMD_VEL + b"  ")) == ["p"] * 2


@pytest.mark.parametrize(
    ("raw", "told"),
    [
        (b"%%", ["empty"]),
        (b"%01/A/b%", ["malformed"]),
        (b"%01//b/s%", ["malformed"]),
        (b"%/A/b/s%", ["malformed"]),
        (b"%01/A//p/1%", ["malformed"]),
        (b"%01/A/b/p%", ["malformed"]),
        (b"%01/A/b/q/1%", ["malformed"]),
        (b"%01/A/b/s/data%", ["malformed"]),
        (b"%\xff\xfe/A/b/s%", ["malformed"]),
        (b"%01/A/b/+pub/nonsense%", ["malformed"]),
        (b"%01/A/b/+pub/=1%", ["malformed"]),
        (b"hello%", ["stray"]),
        (b"%\x00\x01\x02%", ["malformed"]),
        (b"%disconnect%", ["malformed"]),
    ],
)
def test_faults(raw: bytes, told: list[str]) -> None:
    """What is no packet is told by a word, and the next packet is read."""
    parser = Parser()
    assert codes(parser.feed(raw)) == told
    if told == ["stray"] or told == ["empty"]:
        parser.feed(b"01/A/b/s%")
    assert codes(parser.feed(CMD_VEL)) == ["p"]


def test_without_end() -> None:
    """A packet whose end is missing ends where the next begins, and takes none with it."""
    found = parse(b"%01/A/b/p/1" + CMD_VEL + CMD_VEL + CMD_VEL)
    assert codes(found) == ["p", "p", "p", "p"]
    assert isinstance(found[0], Packet)
    assert found[0].data == b"1"


NUMBERED = [b"%01/A/b/p/" + str(number).encode() * 3 + b"%" for number in range(6)]
STRAYS = st.sampled_from([b"%", b"%%", b"%%%", b"% %", b"%\r\n%", b"%?%", b"no packet", b"%no packet", b"no packet%"])


@settings(deadline=None)
@given(st.lists(st.tuples(STRAYS, st.integers(0, len(NUMBERED))), max_size=4), st.integers(1, 7))
def test_stray_percent_signs(strays: list[tuple[bytes, int]], step: int) -> None:
    """Percent signs and bytes that belong to no packet, anywhere between packets, cost no packet."""
    before: dict[int, bytes] = {}
    for stray, place in strays:
        before[place] = before.get(place, b"") + stray
    raw = b"".join(before.get(place, b"") + packet for place, packet in enumerate([*NUMBERED, b""]))
    parser = Parser()
    found = [item for at in range(0, len(raw), step) for item in parser.feed(raw[at : at + step])]
    assert [item.encode() for item in found if isinstance(item, Packet)] == NUMBERED


@pytest.mark.parametrize("place", range(len(NUMBERED[1])))
def test_stray_inside(place: int) -> None:
    """A percent sign in the middle of a packet costs no other one, wherever it stands and however the stream is cut."""
    raw = NUMBERED[0] + NUMBERED[1][:place] + b"%" + NUMBERED[1][place:] + NUMBERED[2] + NUMBERED[3]
    for cut in range(len(raw)):
        parser = Parser()
        packets = [p for p in parser.feed(raw[:cut]) + parser.feed(raw[cut:]) if isinstance(p, Packet)]
        assert packets[0].data == b"000"
        assert [p.data for p in packets[-2:]] == [b"222", b"333"]


def test_long_packet_after_a_stray() -> None:
    """A packet of any allowed size is read behind a stray percent sign."""
    big = b"%01/A/b/p/" + b"x" * 5000 + b"%"
    for stray in (b"%", b"%%", b"%%%"):
        assert codes(parse(CMD_VEL + stray + big, max_bytes=6000)).count("p") == 2


def test_disconnect() -> None:
    """A packet to disconnect has an operation of its own, and topics that are named like it stay topics."""
    (packet,) = parse(b"%01/TURTLESIM/-/d%")
    assert packet == Packet("01", "TURTLESIM", "-", "d")
    assert packet.encode() == b"%01/TURTLESIM/-/d%"
    assert codes(parse(b"%01/ALICE/COS/d/p/stop%%01/ALICE/d/s%%01/ALICE/-/d/s%")) == ["p", "s", "s"]
    assert codes(parse(b"%01/ALICE/COS/d%%01/ALICE/-/d/x%%disconnect%")) == ["malformed"] * 3


def test_origin() -> None:
    """An origin says which node wrote a value, and what kind of node it is."""
    assert iort.origin_of("02", "PEPPER.ab", "robot") == "02@robot:PEPPER.ab"
    assert iort.origin_of("02", "10.0.0.7:1234") == "02@10.0.0.7:1234"
    told = [(iort.identifier_of(origin), iort.kind_of(origin)) for origin in (
        "02@robot:PEPPER.ab", "03@pc:desk", "02@10.0.0.7:1234", "ros:0102@pc:x", "PEPPER.ab", "", "٣٤@robot:x", "1@pc:x"
    )]  # fmt: skip
    assert told == [
        ("02", "robot"), ("03", "pc"), ("02", ""), ("00", "pc"), ("00", ""), ("00", ""), ("00", "robot"), ("00", "pc")
    ]  # fmt: skip


def test_without_start() -> None:
    """A packet whose start is missing is not carried out, and costs no other."""
    assert codes(parse(b"01/A/b/p/1%" + CMD_VEL * 2)) == ["stray", "p", "p"]


def test_too_big() -> None:
    """A packet above the limit is let go and told once it ends; the next is read."""
    big = b"%01/A/b/p/" + b"x" * 2000 + b"%"
    assert codes(parse(big + CMD_VEL, max_bytes=1000)) == ["too-big", "p"]
    parser = Parser(1000)
    told = [code for i in range(0, len(big), 100) for code in codes(parser.feed(big[i : i + 100]))]
    assert [*told, *codes(parser.feed(CMD_VEL))] == ["too-big", "p"]


def test_endless() -> None:
    """100 MB without a percent sign cost no memory, inside a packet or outside."""
    for begin in (b"%01/A/b/p/", b""):
        parser = Parser(1 << 16)
        parser.feed(begin)
        chunk = b"x" * 65536
        tracemalloc.start()
        for _ in range(1600):
            parser.feed(chunk)
        _, peak = tracemalloc.get_traced_memory()
        tracemalloc.stop()
        assert peak < 1 << 20
        assert codes(parser.feed(b"%"))[0] in ("too-big", "stray")


def test_upgrade() -> None:
    """A packet of the upgrade may have any name and any bytes."""
    head = {"n": "1", "t": "5", "o": "a,b=c/d%e~f"}
    packet = Packet("01", "A/B", "50 % ~ topic", "+pub", head, bytes(range(256)))
    raw = packet.encode()
    assert raw.count(b"%") == 2
    assert parse(raw) == [packet]


def test_plain_cannot_hold_all() -> None:
    """What a plain packet cannot hold is refused when it is written, not when it is read."""
    for bad in (("A/B", "c", b""), ("A", "c%", b""), ("A", "c", b"50%"), ("", "c", b"")):
        with pytest.raises(ValueError, match="plain packet"):
            pack("01", bad[0], bad[1], "p", None, bad[2])


NAMES = st.text(st.characters(blacklist_categories=["Cs"]), min_size=1, max_size=12)


@given(NAMES, NAMES, st.dictionaries(st.from_regex(r"[a-z]+", fullmatch=True), NAMES, max_size=3), st.binary())
def test_upgrade_round_trip(system: str, topic: str, head: dict[str, str], data: bytes) -> None:
    """Whatever is packed for the upgrade is parsed as it was."""
    packet = Packet("01", system, topic, "+pub", head, data)
    assert parse(packet.encode()) == [packet]


@given(st.text())
def test_escape(text: str) -> None:
    """Escaping takes away what packets are made of, and can be undone."""
    escaped = escape(text)
    assert not set("/%,=") & set(escaped)
    assert unescape(escaped) == text


PIECES = st.one_of(
    st.just(CMD_VEL),
    st.just(b"%01/A/b/s%"),
    st.just(b"%"),
    st.just(b"/p/"),
    st.binary(max_size=20),
    st.just(b"%01/A/b/+pub/n=1/~2x%"),
)


@settings(deadline=None)
@given(st.lists(PIECES, max_size=12), st.data())
def test_cut_anywhere(pieces: list[bytes], data: st.DataObject) -> None:
    """However a stream is cut, the same packets and the same faults come out."""
    raw = b"".join(pieces)
    whole = parse(raw, max_bytes=200)
    parser = Parser(200)
    found: list[Packet | Fault] = []
    rest = raw
    while rest:
        size = data.draw(st.integers(1, max(1, len(rest))))
        found += parser.feed(rest[:size])
        rest = rest[size:]
    assert codes(found) == codes(whole)
    assert [p for p in found if isinstance(p, Packet)] == [p for p in whole if isinstance(p, Packet)]


@given(st.binary(max_size=500))
def test_any_bytes(raw: bytes) -> None:
    """No bytes make the parser fail, and every packet behind them is read."""
    parser = Parser()
    parser.feed(raw)
    assert [item for item in parser.feed(CMD_VEL * 3) if isinstance(item, Packet)][-3:] == parse(CMD_VEL * 3)


def test_old_python() -> None:
    """The file can be parsed by Python 3.8 and imports nothing but the standard library."""
    source = Path(iort.__file__).read_text()
    tree = ast.parse(source, feature_version=(3, 8))
    imported = {
        (node.module or "").partition(".")[0] if isinstance(node, ast.ImportFrom) else node.names[0].name
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert imported <= {name.partition(".")[0] for name in sys.stdlib_module_names} | {"__future__"}


def test_copied_file(tmp_path: Path) -> None:
    """A copy of the file alone works, without the rest of the package."""
    (tmp_path / "iort.py").write_text(Path(iort.__file__).read_text())
    code = "import iort, sys; assert not any(m.startswith('ropeway') for m in sys.modules); print(iort.Node.__name__)"
    done = subprocess.run(
        [sys.executable, "-I", "-c", f"import sys; sys.path.insert(0, {str(tmp_path)!r}); {code}"],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.stdout == "Node\n", done.stderr


def test_a_head_of_many_values() -> None:
    """A packet whose head has far more values than any has is malformed, and costs no other packet."""
    head = b",".join(b"%x=" % number for number in range(100_000))
    found = Parser(1 << 20).feed(b"%01/S/t/+pub/" + head + b"/x%%01/S/t/p/1%")
    assert [type(each).__name__ for each in found] == ["Fault", "Packet"]
    assert isinstance(found[0], Fault)
    assert found[0].code == "malformed"
    assert isinstance(_one(b"%01/S/t/+pub/" + b",".join(b"k%d=" % n for n in range(64)) + b"/x%"), Packet)


def _one(raw: bytes) -> object:
    (found,) = Parser().feed(raw)
    return found
