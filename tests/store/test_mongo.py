"""What others change in MongoDB, followed through change streams and by reading."""

from __future__ import annotations

import asyncio
from collections.abc import Iterator
from pathlib import Path

import pytest

from ropeway.errors import StoreUnavailable
from ropeway.store import Store, make_backend, make_mirror
from ropeway.store.entry import FOREIGN, Change, Entry
from ropeway.store.mongo import POLL_S, MongoBackend
from tests.store.mongo_streams import StreamServer, stream_server
from tests.support.until import until


@pytest.fixture
def server() -> Iterator[StreamServer]:
    with stream_server() as made:
        yield made


@pytest.fixture
def backend(server: StreamServer) -> Iterator[MongoBackend]:
    made = MongoBackend(server.url)
    made.open()
    yield made
    made.close()


def changed(backend: MongoBackend) -> Change:
    """What comes next on the stream."""
    while not ((change := backend.changes()).entries or change.gone):
        pass
    return change


def values(change: Change) -> list[tuple[str, str, bytes]]:
    return [(entry.system, entry.topic, entry.data) for entry in change.entries]


def test_a_stream_tells_what_others_change(server: StreamServer, backend: MongoBackend) -> None:
    """What is inserted, changed and deleted is told once each, without reading everything again."""
    server.put("PEPPER", {"_id": "a", "data": "1"})
    assert [entry.data for entry in backend.load()] == [b"1"]
    assert (backend.follows, backend.pause_s) == ("change stream", 0.0)
    server.commands.clear()
    server.put("PEPPER", {"_id": "b", "data": "2"})
    assert values(changed(backend)) == [("PEPPER", "b", b"2")]
    server.put("PEPPER", {"_id": "b", "data": "3"})
    server.put("PEPPER", {"_id": "b", "data": "4"})
    assert values(changed(backend)) == [("PEPPER", "b", b"4")]
    server.delete("PEPPER", "a")
    assert changed(backend).gone == [("PEPPER", "a")]
    assert "listCollections" not in server.commands
    assert set(server.commands) <= {"getMore", "find", "hello"}


def test_what_we_write_is_no_news(server: StreamServer, backend: MongoBackend) -> None:
    """A stream tells of our own writes, too, and they are passed over; names of systems come back as they were."""
    backend.load()
    backend.write([Entry("a.b/ü", "own", b"1", 5, 6, "node")], 0)
    server.put("a.b%2F%C3%BC", {"_id": "other", "data": "2"})
    assert values(changed(backend)) == [("a.b/ü", "other", b"2")]


def test_events_without_a_document_have_all_read_again(server: StreamServer, backend: MongoBackend) -> None:
    """A collection that is dropped takes its values along, though no document is named."""
    server.put("PEPPER", {"_id": "a", "data": "1"})
    server.put("ALICE", {"_id": "a", "data": "1"})
    backend.load()
    server.drop("PEPPER")
    assert changed(backend).gone == [("PEPPER", "a")]


def test_news_do_not_wait_for_more(server: StreamServer, backend: MongoBackend) -> None:
    """What came on a stream is told at once, with one question to the server, however many changes follow."""
    backend.load()
    for number in range(5):
        server.put("PEPPER", {"_id": "a", "data": str(number)})
    server.commands.clear()
    assert values(backend.changes()) == [("PEPPER", "a", b"4")]
    assert [name for name in server.commands if name != "hello"] == ["getMore", "find"]


def test_a_stream_that_ends(server: StreamServer, backend: MongoBackend) -> None:
    """A stream ends with its database; another one is made, and all is read again."""
    server.put("PEPPER", {"_id": "a", "data": "1"})
    backend.load()
    server.end_streams()
    server.put("PEPPER", {"_id": "b", "data": "2"})
    assert values(changed(backend)) == [("PEPPER", "b", b"2")]
    server.put("PEPPER", {"_id": "b", "data": "3"})
    assert values(changed(backend)) == [("PEPPER", "b", b"3")]
    assert server.commands.count("aggregate") == 2


def test_documents_that_are_no_values(server: StreamServer, backend: MongoBackend) -> None:
    """Documents without data, or with an id that is no text, are passed over; those beside them are told."""
    backend.load()
    server.put("PEPPER", {"_id": 7, "data": "1"})
    server.put("PEPPER", {"_id": "none"})
    server.put("PEPPER", {"_id": "c", "data": {"x": 1}})
    change = changed(backend)
    assert values(change) == [("PEPPER", "c", b'{"x": 1}')]
    assert change.entries[0].origin == FOREIGN


def test_a_stream_that_breaks(server: StreamServer, backend: MongoBackend) -> None:
    """A stream whose history is lost is an error of the server, after which another connection begins anew."""
    backend.load()
    server.break_streams()
    with pytest.raises(StoreUnavailable, match="history lost"):
        while True:
            backend.changes()
    backend.open()
    assert backend.load() == []
    assert backend.follows == "change stream"


def test_a_server_without_streams_is_read() -> None:
    """Where change streams are refused all documents are read each second, until a server is met that has them."""
    with stream_server(streams=False) as server:
        backend = MongoBackend(server.url)
        backend.open()
        server.put("PEPPER", {"_id": "a", "data": "1"})
        assert len(backend.load()) == 1
        assert backend.follows == f"read every {POLL_S:g} s"
        assert backend.pause_s >= POLL_S
        server.put("PEPPER", {"_id": "a", "data": "2"})
        server.put("PEPPER", {"_id": "b", "data": "3"})
        assert values(backend.changes()) == [("PEPPER", "a", b"2"), ("PEPPER", "b", b"3")]
        server.delete("PEPPER", "a")
        assert backend.changes().gone == [("PEPPER", "a")]
        assert not backend.changes().entries
        server.streams = True
        backend.open()
        backend.load()
        assert backend.follows == "change stream"
        backend.close()


async def test_a_store_follows_the_stream(tmp_path: Path, server: StreamServer) -> None:
    """A store serves what a program changes, goes on after the stream broke, and its own values win nothing back."""
    store = Store(make_backend(str(tmp_path / "s.sqlite")), mirror=make_mirror(server.url))
    await store.open()

    async def served(topic: str, data: bytes) -> None:
        await until(lambda: (e := store.get("PEPPER", topic)) is not None and e.data == data)

    try:
        await until(lambda: store.status()["mirror"]["follows"] == "change stream")
        await asyncio.to_thread(server.put, "PEPPER", {"_id": "a", "data": "1"})
        await served("a", b"1")
        await asyncio.to_thread(server.break_streams)
        await asyncio.to_thread(server.put, "PEPPER", {"_id": "a", "data": "2"})
        await served("a", b"2")
        store.put(Entry("PEPPER", "b", b"node", store.versions.next(0), 1, "node"))
        await until(lambda: (server.document("PEPPER", "b") or {}).get("data") == "node")
        await asyncio.to_thread(server.delete, "PEPPER", "a")
        await until(lambda: store.get("PEPPER", "a") is None)
        await served("b", b"node")
    finally:
        await store.close()
