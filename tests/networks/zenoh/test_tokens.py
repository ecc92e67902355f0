"""ropeway.networks.zenoh.tokens: by which nodes show themselves."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.limits import ZENOH_TOKEN_CHARACTERS
from ropeway.networks.zenoh.attachment import parse
from ropeway.networks.zenoh.tokens import ZenohToken, data_key, enclave_of, gid_of, parse_token, tokens_of
from ropeway.qos import QoS

from .genuine import MESSAGES, REQUESTS, TOKENS

_HASH = "RIHS01_df668c740482bbd48fb39d76a70dfd4bd59db1288021743503259e948f6b1a18"
_TALKER = ZenohToken(
    0, "a1b2", "0", "7", "publisher", "/ns/talker", "/", "/ns/chatter", "std_msgs/msg/String", _HASH, QoS(depth=7)
)
_TEXT = f"@ros2_lv/0/a1b2/0/7/MP/%/%ns/talker/%ns%chatter/std_msgs::msg::dds_::String_/{_HASH}/::,7:,:,:,,"

_names = st.from_regex(r"\A(/[A-Za-z_][A-Za-z0-9_]{0,8}){1,3}\Z")


def test_written() -> None:
    """A token has the form that rmw_zenoh gives it."""
    assert str(_TALKER) == _TEXT
    node = ZenohToken(5, "a1b2", "0", "0", "node", "/talker")
    assert str(node) == "@ros2_lv/5/a1b2/0/0/NN/%/%/talker"


@given(st.sampled_from(["publisher", "subscription", "server", "client"]), _names, _names, st.integers(0, 232))
def test_round_trip(kind: str, node: str, name: str, domain: int) -> None:
    """A token is read as it was written."""
    token = replace(_TALKER, kind=kind, node=node, name=name, domain=domain)
    assert parse_token(str(token)) == token


def test_buffers() -> None:
    """What nodes since Lyrical append about buffers is left alone."""
    assert parse_token(f"{_TEXT}/backends:cpu:") == _TALKER


@pytest.mark.parametrize(
    "token",
    [
        "",
        "@ros2_lv",
        "@ros2_lv/0/a1b2/0/0/NN/%/%/",
        "@ros2_lv/0/a1b2/0/0/XX/%/%/talker",
        "@ros2_lv/-1/a1b2/0/0/NN/%/%/talker",
        f"@ros2_lv/{10**30}/a1b2/0/0/NN/%/%/talker",
        "@ros2_lv/0/zzzz/0/0/NN/%/%/talker",
        "@ros2_lv/0/a1b2/x/0/NN/%/%/talker",
        "@ros2_lv/0/a1b2/0/0/NN/%/%/%talker",
        "@ros2_lv/0/a1b2/0/0/NN/%/%/two words",
        "other/0/a1b2/0/0/NN/%/%/talker",
        _TEXT.replace("MP", "MS").replace("::,7:,:,:,,", ""),
        _TEXT.replace("::,7:,:,:,,", "::,7:"),
        _TEXT.replace("%chatter", "%9chatter"),
        _TEXT.replace("%ns%chatter", "chatter"),
        _TEXT.replace("std_msgs::msg::dds_::String_", "String"),
        _TEXT.replace(_HASH, "RIHS01 *"),
        _TEXT.replace(_HASH, "R" * 200),
        _TEXT + "/x" * ZENOH_TOKEN_CHARACTERS,
    ],
)
def test_refused(token: str) -> None:
    """A malformed token is none, whatever is wrong with it."""
    assert parse_token(token) is None


@given(st.lists(st.text(alphabet="%/:,09azMPNS_-*é", max_size=9), max_size=15).map("/".join))
def test_any_text(rest: str) -> None:
    """Any text is a token or none; what is one is written as a token that means the same."""
    found = parse_token(f"@ros2_lv/0/{rest}")
    assert found is None or parse_token(str(found)) == found


def test_gateway() -> None:
    """Our own nodes are known by their enclave, and a gateway by its id there, whatever characters it has."""
    assert not _TALKER.ours
    assert _TALKER.gateway == ""
    for id in ("robot1", "a/b c", "~x", "é"):
        found = parse_token(str(replace(_TALKER, enclave=enclave_of(id))))
        assert found is not None
        assert (found.ours, found.gateway) == (True, id)
    assert replace(_TALKER, enclave=enclave_of("")).ours
    assert replace(_TALKER, enclave=enclave_of("")).gateway == ""
    assert replace(_TALKER, enclave="/ropeway/~zz").gateway == "~zz"
    assert not replace(_TALKER, enclave="/ropeways").ours
    copy = replace(_TALKER, enclave=enclave_of("robot1", copy=True))
    assert (copy.ours, copy.copy, copy.gateway) == (True, True, "robot1")
    assert not replace(_TALKER, enclave=enclave_of("robot1")).copy


def test_keys() -> None:
    """Data travels under the domain, the name, the type and its hash."""
    assert data_key(3, "/ns/chatter", "std_msgs/msg/String", _HASH) == (
        f"3/ns/chatter/std_msgs::msg::dds_::String_/{_HASH}"
    )
    assert tokens_of(3) == "@ros2_lv/3/**"


@pytest.mark.parametrize("text", TOKENS, ids=lambda text: text.split("/", 4)[4].partition("/RIHS")[0])
def test_genuine(text: str) -> None:
    """A token of a genuine node is read, and written again as it came, but for its liveliness."""
    token = parse_token(text)
    assert token is not None
    assert (token.domain, token.node, token.ours) == (9, "/robot/genuine", False)
    if token.name != "/alive":
        assert str(token) == text


def test_genuine_profiles() -> None:
    """The profiles that a genuine node was given are those that its tokens tell."""
    tokens = [token for text in TOKENS if (token := parse_token(text)) is not None]
    profiles = {token.name: token.qos for token in tokens if token.kind in ("publisher", "subscription")}
    assert profiles["/robot/plain"] == QoS(depth=10)
    assert profiles["/latched"] == QoS(durability="transient_local", depth=2)
    assert profiles["/fast"] == QoS(reliability="best_effort", depth=5)
    assert profiles["/timed"] == QoS(depth=1, deadline_s=1.000000005, lifespan_s=2.0)
    assert profiles["/all"].history == "keep_all"
    assert profiles["/heard"] == QoS(reliability="best_effort", depth=3)


@pytest.mark.parametrize("message", [*MESSAGES, *REQUESTS], ids=lambda message: message["key"].partition("/RIHS")[0])
def test_genuine_keys_and_gids(message: dict[str, str]) -> None:
    """A genuine node sends under the key of its token's name, type and hash, with the gid that follows from it."""
    found = parse(bytes.fromhex(message["attachment"]))
    assert found is not None
    (text,) = (text for text in TOKENS if gid_of(text) == found.gid)
    token = parse_token(text)
    assert token is not None
    assert data_key(9, token.name, token.type, token.type_hash) == message["key"]
