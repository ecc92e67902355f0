"""The library and its layouts."""

from __future__ import annotations

import ctypes
from collections.abc import Callable
from pathlib import Path

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.networks.dds import library, raw, selftest
from ropeway.networks.dds.raw import lib
from ropeway.qos import QoS
from tests.support.messages import text

from .conftest import Join
from .helpers import DDS_STRING


@pytest.fixture
def unverified(monkeypatch: pytest.MonkeyPatch) -> None:
    """As in a process that has opened no graph yet."""
    monkeypatch.setitem(selftest._state, "verified", False)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        (lambda layout: layout._replace(timestamp=24), "timestamp"),
        (lambda layout: layout._replace(size=68), "size"),
        (lambda layout: layout._replace(header=112), "payload"),
    ],
    ids=["timestamp", "size", "header"],
)
async def test_other_layout(
    join: Join,
    monkeypatch: pytest.MonkeyPatch,
    unverified: None,
    change: Callable[[library.Layout], library.Layout],
    told: str,
) -> None:
    """A library whose structs differ is refused before anything is read from them, with what differs."""
    layouts = [change(layout) for layout in library.LAYOUTS]
    monkeypatch.setattr(library, "LAYOUTS", layouts)
    with pytest.raises(GraphUnavailable, match=told):
        await join()


async def test_layout_of_this_version(join: Join, unverified: None) -> None:
    """The layout that fits is one of those known for the version of the library."""
    await join()
    assert library.version_of(Path(lib.name.split()[0])).startswith(lib.version.split()[0])


async def test_other_sample_info(join: Join, monkeypatch: pytest.MonkeyPatch, unverified: None) -> None:
    """Another layout of the sample info is refused."""
    import struct

    monkeypatch.setattr(raw, "INFO", struct.Struct("=12xI?3xqQQ20x"))
    with pytest.raises(GraphUnavailable, match=r"sample info|builtin topics"):
        await join()


async def test_verified_once(join: Join, unverified: None) -> None:
    """The self-test passes with the library, and is done once."""
    await join()
    assert selftest._state["verified"]


@pytest.mark.parametrize("payload", [text("x"), b"\0\1\0\0" + bytes(100_000), b"\0\1\0\3abcd"])
async def test_serdata_round_trip(join: Join, payload: bytes) -> None:
    """Bytes come out of DDS as they went in."""
    graph = await join()
    writer = graph.participant.create_writer(("rt/t", DDS_STRING), QoS(), b"", print)
    serdata = raw.make_serdata(writer._sertype, payload)
    assert ctypes.string_at(serdata + lib.header_at, len(payload)) == payload
    raw.lib.serdata_unref(serdata)


async def test_errors_speak(join: Join) -> None:
    """An error code of the library is raised as what was tried and what it means."""
    await join()
    with pytest.raises(raw.DdsError, match=r"open sesame: Bad Parameter \(-3\)"):
        raw.check(-3, "open sesame")
    assert raw.check(5, "x") == 5


def test_no_library(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without a library, the graph says why, and what to install."""
    monkeypatch.setattr(raw.Lib, "loaded", False)
    monkeypatch.setattr(library, "_candidates", lambda _: iter(()))
    monkeypatch.delenv(library.ENVIRONMENT, raising=False)
    with pytest.raises(GraphUnavailable, match=r"^dds:0: no Cyclone DDS library .*cyclonedds"):
        raw.load("dds:0")
