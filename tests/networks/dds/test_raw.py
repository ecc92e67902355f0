"""The library and its layouts."""

from __future__ import annotations

import ctypes
import importlib.util

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.networks.dds import raw, selftest
from ropeway.qos import QoS
from tests.support.messages import text

from .conftest import Join
from .helpers import DDS_STRING


@pytest.fixture
def unverified(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a process that has opened no graph yet."""
    monkeypatch.setitem(selftest._state, "verified", False)


@pytest.mark.parametrize(
    ("name", "value", "told"),
    [
        ("SERDATA_TIMESTAMP", 24, "timestamp"),
        ("SERDATA_SIZE", 68, "size"),
        ("SERDATA_HEADER", 112, "payload"),
    ],
)
async def test_other_layout(
    join: Join, monkeypatch: pytest.MonkeyPatch, unverified: None, name: str, value: int, told: str
) -> None:
    """A library whose structs differ is refused before anything is read from them, with what differs."""
    monkeypatch.setattr(raw, name, value)
    with pytest.raises(GraphUnavailable, match=told):
        await join()


async def test_other_sample_info(join: Join, monkeypatch: pytest.MonkeyPatch, unverified: None) -> None:
    """Another layout of the sample info is refused."""
    import struct

    monkeypatch.setattr(raw, "INFO", struct.Struct("=12xI?3xqQQ20x"))
    with pytest.raises(GraphUnavailable, match=r"sample info|builtin topics"):
        await join()


async def test_verified_once(join: Join, unverified: None) -> None:
    """The self-test passes with the pinned wheel, and is done once."""
    await join()
    assert selftest._state["verified"]


@pytest.mark.parametrize("payload", [text("x"), b"\0\1\0\0" + bytes(100_000), b"\0\1\0\3abcd"])
async def test_serdata_round_trip(join: Join, payload: bytes) -> None:
    """Bytes come out of DDS as they went in."""
    graph = await join()
    writer = graph.participant.create_writer(("rt/t", DDS_STRING), QoS(), b"", print)
    serdata = raw.make_serdata(writer._sertype, payload)
    assert ctypes.string_at(serdata + raw.SERDATA_HEADER, len(payload)) == payload
    raw.lib.serdata_unref(serdata)


async def test_errors_speak(join: Join) -> None:
    """An error code of the library is raised as what was tried and what it means."""
    await join()
    with pytest.raises(raw.DdsError, match=r"open sesame: Bad Parameter \(-3\)"):
        raw.check(-3, "open sesame")
    assert raw.check(5, "x") == 5


def test_no_wheel(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without the wheel, the error says how to get it."""
    monkeypatch.setattr(raw.Lib, "loaded", False)
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)
    with pytest.raises(GraphUnavailable, match="pip install"):
        raw.load("dds:0")
