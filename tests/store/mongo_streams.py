"""A small server of MongoDB's wire protocol with change streams, which the servers that tests can have do not know.

It is a replica set of one: documents in memory, by collection; the commands that the store uses and no others.
"""

from __future__ import annotations

import itertools
import re
import socketserver
import struct
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import bson

__all__ = ["StreamServer", "stream_server"]

Document = dict[str, Any]

_OP_REPLY, _OP_QUERY, _OP_MSG = 1, 2004, 2013
_HEADER_BYTES = 16
_NO_STREAMS = 40573  # what a server that is no replica set says
_HISTORY_LOST = 286


class StreamServer:
    """The server; ``streams`` says whether it has change streams, ``commands`` lists what it was asked for."""

    def __init__(self, *, streams: bool = True) -> None:
        self.streams = streams
        self.commands: list[str] = []
        self._documents: dict[str, dict[Any, Document]] = {}
        self._cursors: dict[int, list[Document]] = {}  # change streams, with the events that wait
        self._broken: set[int] = set()
        self._ended: set[int] = set()
        self._numbers = itertools.count(1)
        self._changed = threading.Condition()
        handler = type("Handler", (_Handler,), {"database": self})
        self._server = _Server(("127.0.0.1", 0), handler)
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.01,), daemon=True)
        self._thread.start()
        self.address = f"127.0.0.1:{self._server.server_address[1]}"
        self.url = f"mongodb://{self.address}/ropeway?directConnection=true"

    def close(self) -> None:
        with self._changed:
            self._broken.update(self._cursors)
            self._changed.notify_all()
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()

    # ── what another program does ──────────────────────────────────────────────────────────────────────────────────

    def put(self, collection: str, document: Document) -> None:
        """Insert or replace a document."""
        with self._changed:
            kind = "replace" if document["_id"] in self._documents.get(collection, ()) else "insert"
            self._documents.setdefault(collection, {})[document["_id"]] = document
            self._tell(kind, collection, document["_id"])

    def delete(self, collection: str, id: Any) -> None:
        with self._changed:
            del self._documents[collection][id]
            self._tell("delete", collection, id)

    def drop(self, collection: str) -> None:
        """Drop a collection; a stream tells that, and not of its documents."""
        with self._changed:
            del self._documents[collection]
            self._tell("drop", collection, None)

    def break_streams(self) -> None:
        """Have every stream fail at its next question, as one does whose history is lost."""
        with self._changed:
            self._broken.update(self._cursors)
            self._changed.notify_all()

    def end_streams(self) -> None:
        """End every stream, as those of a database that is dropped do."""
        with self._changed:
            self._ended.update(self._cursors)
            self._changed.notify_all()

    def document(self, collection: str, id: Any) -> Document | None:
        with self._changed:
            return self._documents.get(collection, {}).get(id)

    def _tell(self, kind: str, collection: str, id: Any) -> None:
        number = next(self._numbers)
        event: Document = {
            "_id": {"_data": f"{number:08x}"},
            "operationType": kind,
            "ns": {"db": "ropeway", "coll": collection},
        }
        if id is not None:
            event["documentKey"] = {"_id": id}
        for waiting in self._cursors.values():
            waiting.append(event)
        self._changed.notify_all()

    # ── commands ───────────────────────────────────────────────────────────────────────────────────────────────────

    def answer(self, command: Document) -> Document:
        name = next(iter(command))
        with self._changed:
            self.commands.append(name)
            method = getattr(self, f"_do_{name.lower()}", None)
            return {"ok": 0, "code": 59, "errmsg": f"no such command: {name}"} if method is None else method(command)

    def _do_hello(self, _: Document) -> Document:
        return {
            "helloOk": True,
            "ismaster": True,
            "isWritablePrimary": True,
            "setName": "rs0",
            "hosts": [self.address],
            "me": self.address,
            "maxBsonObjectSize": 16 << 20,
            "maxMessageSizeBytes": 48_000_000,
            "maxWriteBatchSize": 1000,
            "logicalSessionTimeoutMinutes": 30,
            "minWireVersion": 0,
            "maxWireVersion": 21,
            "ok": 1,
        }

    _do_ismaster = _do_hello

    def _do_ping(self, _: Document) -> Document:
        return {"ok": 1}

    _do_endsessions = _do_killcursors = _do_ping

    def _do_listcollections(self, command: Document) -> Document:
        wanted = command.get("filter", {}).get("name")
        names = [name for name in self._documents if wanted in (None, name)]
        found = [{"name": name, "type": "collection"} for name in names]
        return _first("$cmd.listCollections", found)

    def _do_find(self, command: Document) -> Document:
        documents = self._documents.get(command["find"], {})
        chosen = command.get("filter", {}).get("_id")
        found = [document for id, document in documents.items() if chosen in (None, id)]
        return _first(command["find"], found)

    def _do_update(self, command: Document) -> Document:
        """Take ``$set`` alone, with ``upsert``; a filter's ``$nor`` holds versions that must not be there."""
        collection = command["update"]
        for update in command["updates"]:
            id = update["q"]["_id"]
            self._documents.setdefault(collection, {}).setdefault(id, {"_id": id}).update(update["u"]["$set"])
            self._tell("update", collection, id)
        return {"n": len(command["updates"]), "nModified": len(command["updates"]), "ok": 1}

    def _do_aggregate(self, command: Document) -> Document:
        assert "$changeStream" in command["pipeline"][0]
        if not self.streams:
            text = "The $changeStream stage is only supported on replica sets"
            return {"ok": 0, "code": _NO_STREAMS, "codeName": "Location40573", "errmsg": text}
        cursor = next(self._numbers)
        self._cursors[cursor] = []
        return {"cursor": {**_batch([]), "id": bson.Int64(cursor)}, "ok": 1}

    def _do_getmore(self, command: Document) -> Document:
        cursor = command["getMore"]
        wait_s = command.get("maxTimeMS", 1000) / 1000

        def ready() -> bool:
            return bool(self._cursors.get(cursor)) or cursor in self._broken or cursor in self._ended

        self._changed.wait_for(ready, wait_s)
        if cursor in self._broken:
            return {"ok": 0, "code": _HISTORY_LOST, "codeName": "ChangeStreamHistoryLost", "errmsg": "history lost"}
        events, self._cursors[cursor] = self._cursors[cursor], []
        id = 0 if cursor in self._ended else cursor
        return {"cursor": {**_batch(events, "nextBatch"), "id": bson.Int64(id)}, "ok": 1}


def _first(collection: str, found: list[Document]) -> Document:
    return {"cursor": {"id": bson.Int64(0), "ns": f"ropeway.{collection}", "firstBatch": found}, "ok": 1}


def _batch(events: list[Document], name: str = "firstBatch") -> Document:
    token = events[-1]["_id"] if events else {"_data": "00000000"}
    return {"ns": "ropeway.$cmd.aggregate", name: events, "postBatchResumeToken": token}


class _Server(socketserver.ThreadingTCPServer):
    allow_reuse_address = daemon_threads = True


class _Handler(socketserver.BaseRequestHandler):
    """One connection."""

    database: StreamServer

    def handle(self) -> None:
        while (header := self._read(_HEADER_BYTES)) is not None:
            size, number, _, code = struct.unpack("<4i", header)
            body = self._read(size - _HEADER_BYTES)
            if body is None:
                return
            command = _query(body) if code == _OP_QUERY else _message(body)
            answer = bson.encode(self.database.answer(command))
            if code == _OP_QUERY:
                self._send(number, _OP_REPLY, struct.pack("<iqii", 8, 0, 0, 1) + answer)
            else:
                self._send(number, _OP_MSG, struct.pack("<iB", 0, 0) + answer)

    def _read(self, size: int) -> bytes | None:
        data = b""
        while len(data) < size:
            try:
                more = self.request.recv(size - len(data))
            except OSError:
                return None
            if not more:
                return None
            data += more
        return data

    def _send(self, number: int, code: int, body: bytes) -> None:
        self.request.sendall(struct.pack("<4i", _HEADER_BYTES + len(body), 0, number, code) + body)


def _query(body: bytes) -> Document:
    """The command in an ``OP_QUERY``, by which a client says hello."""
    end = body.index(b"\0", 4)
    return bson.decode(body[end + 1 + 8 :])


def _message(body: bytes) -> Document:
    """The command in an ``OP_MSG``, with the documents of its sequences."""
    command: Document = {}
    at = 4
    while at < len(body):
        kind, size = body[at], int.from_bytes(body[at + 1 : at + 5], "little")
        section = body[at + 1 : at + 1 + size]
        if kind == 0:
            command = {**bson.decode(section), **command}
        else:
            name = re.match(rb"[^\0]*", section[4:])
            assert name is not None
            command[name[0].decode()] = bson.decode_all(section[4 + len(name[0]) + 1 :])
        at += 1 + size
    first = next(key for key in command if key not in ("updates", "documents", "deletes"))
    return {first: command.pop(first), **command}


@contextmanager
def stream_server(*, streams: bool = True) -> Iterator[StreamServer]:
    """A server for one test."""
    server = StreamServer(streams=streams)
    try:
        yield server
    finally:
        server.close()
