"""Global names."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.networks.overlay.names import NAME_BYTES, Metadata, global_name

SECRET = bytes(range(32))
IMAGE = ("topic", "/camera", "sensor_msgs/msg/Image")

# fmt: off
VECTORS = [
    (IMAGE, Metadata(),
     "403d81f868b9e7ec81e7cf15fee11f3020df1fdad3ce61168b89dbe8201568eb"),
    (
        IMAGE,
        Metadata(author="ann", maintainer="bob", description="front camera"),
        "b91fed2e15a2d58c30a37e2baef6356e625a58843f2ccdb68a5af1017bc95a76",
    ),
    (IMAGE, Metadata(unique="cell 7"),
     "24870a69ab75b2fec090ef5aed6edb9e2985ce5cacdff050495f67b03a340690"),
    (
        ("service", "/add", "example_interfaces/srv/AddTwoInts"),
        Metadata(),
        "84032ff0bbcb87f7140a839b58dc4455bab7274834cab7144643e6ecebe7854b",
    ),
    (
        ("topic", "/été", "std_msgs/msg/String"),
        Metadata(),
        "9c2fe7ce72e51f7d18043164b3a0ddb229333cdce38d851769b1ae33c27de78d",
    ),
]
# fmt: on


@pytest.mark.parametrize(("what", "metadata", "expected"), VECTORS)
def test_vectors(what: tuple[str, str, str], metadata: Metadata, expected: str) -> None:
    """The names are those of the vectors, in every version and at every site."""
    assert global_name(SECRET, *what, metadata).hex() == expected


def test_replicas() -> None:
    """The same metadata gives the same name; another unique text, kind, name, type or secret another one."""
    same = global_name(SECRET, *IMAGE, Metadata())
    assert same == global_name(SECRET, *IMAGE)
    others = {
        global_name(SECRET, *IMAGE, Metadata(unique="x")),
        global_name(SECRET, "service", *IMAGE[1:]),
        global_name(SECRET, "topic", "/camera2", IMAGE[2]),
        global_name(SECRET, "topic", "/camera", "sensor_msgs/msg/CompressedImage"),
        global_name(bytes(32), *IMAGE),
    }
    assert same not in others
    assert len(others) == 5


def test_a_node_in_a_name() -> None:
    """A node makes another name of the same metadata, and none at all is as it was before names had nodes."""
    assert Metadata("a", "b", "c", "d").fields() == ("a", "b", "c", "d")
    assert Metadata("a", "b", "c", "d", "/n").fields() == ("a", "b", "c", "d", "/n")
    names = {global_name(SECRET, *IMAGE, Metadata(node=node)) for node in ("", "/camera", "/lidar")}
    assert len(names) == 3


def test_fields_do_not_run_together() -> None:
    """Text that moves from one field to the next makes another name."""
    assert global_name(SECRET, "topic", "/a", "bc") != global_name(SECRET, "topic", "/ab", "c")
    assert global_name(SECRET, *IMAGE, Metadata("x", "")) != global_name(SECRET, *IMAGE, Metadata("", "x"))


@given(st.text(min_size=1, max_size=30), st.integers(0, 2000))
def test_avalanche(text: str, bit: int) -> None:
    """One flipped bit of a field flips about half of the bits of the name."""
    raw = bytearray(text.encode())
    raw[bit // 8 % len(raw)] ^= 1 << bit % 8
    try:
        other = raw.decode()
    except UnicodeDecodeError:
        return
    one, two = (int.from_bytes(global_name(SECRET, "topic", name, "t"), "big") for name in (text, other))
    assert 80 < (one ^ two).bit_count() < 176
    assert len(global_name(SECRET, "topic", text, "t")) == NAME_BYTES


def test_unknown_kind() -> None:
    """A kind that there is not is refused with those that there are."""
    with pytest.raises(ValueError, match="topic, service, action"):
        global_name(SECRET, "node", "/a", "b")
