"""Keeps last values in MongoDB as the IoRT paper has them: a collection per system, a document per topic."""

from __future__ import annotations

import contextlib
import json
import logging
import threading
import time
from collections.abc import Iterator
from typing import Any, Final
from urllib.parse import quote, unquote, urlsplit

from ropeway.errors import StoreUnavailable
from ropeway.extras import require
from ropeway.iort import latest_version
from ropeway.store.entry import FOREIGN, Change, Entry, Key
from ropeway.store.mongo_stream import ChangeStream

__all__ = ["POLL_S", "MongoBackend"]

log = logging.getLogger("ropeway.store")

_TIMEOUT_MS: Final = 3000
_INVALID_NAMESPACE: Final = 73  # a name that is too long for a collection
_DATABASE: Final = "ropeway"
_FIELDS: Final = {"history": 0}
POLL_S: Final = 1.0
"""How often all documents are read where the server has no change streams."""
_POLL_SHARE: Final = 20


class MongoBackend:
    """Keeps values in the database that ``url`` names (``ropeway`` if it names none), through pymongo.

    A document is ``{_id: TOPIC, data, version, stamp_ns, origin, type, form, history}``. Data that is text is text
    there, too. An entry never replaces a later one, also if several servers write.

    Documents of other programs need ``_id`` and ``data`` only; data that is neither text nor bytes is served as JSON.
    What others change is followed through change streams where the server has them (a replica set), else by reading
    all documents each second, or less often where that takes more than a twentieth of the time.
    """

    def __init__(self, url: str) -> None:
        require("mongo", "a store in MongoDB")
        parts = urlsplit(url)
        self.url = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()  # no password in a log
        self._url = url
        self._database = parts.path.strip("/") or _DATABASE
        self._client: Any = None
        self._lock = threading.Lock()  # between writing and reading what others wrote
        self._seen: dict[Key, int] = {}  # a mark of each document as it was seen or written last
        self._stream: ChangeStream | None = None
        self._streams = True  # until the server says that it has none
        self._pause_s = POLL_S

    @property
    def follows(self) -> str:
        """The way in which changes are followed."""
        return "change stream" if self._stream is not None else f"read every {self.pause_s:g} s"

    @property
    def pause_s(self) -> float:
        """The time to wait before ``changes`` is called again."""
        return 0.0 if self._stream is not None else self._pause_s

    def open(self) -> None:
        """Connect; the server must answer within 3 s."""
        from pymongo import MongoClient  # a fifth of a second that only this needs

        self.close()
        self._streams = True  # it may be another server than before
        with self._told():
            self._client = MongoClient(
                self._url,
                serverSelectionTimeoutMS=_TIMEOUT_MS,
                connectTimeoutMS=_TIMEOUT_MS,
                socketTimeoutMS=3 * _TIMEOUT_MS,
                retryWrites=False,
            )
            self._client.admin.command("ping")

    def load(self) -> list[Entry]:
        """Return every last value, those of other programs as well."""
        with self._lock, self._told():
            self._seen.clear()
            self._stream = self._open_stream()
            return self._look_at_all().entries

    def find(self, key: Key) -> tuple[Entry | None, bool]:
        """Return the last value of a topic, and whether its system has a collection."""
        system, topic = key
        name, read_ns = _collection(system), time.time_ns()
        with self._lock, self._told():
            database = self._db()
            document = database[name].find_one({"_id": topic}, _FIELDS)
            if document is not None:
                self._seen[key] = _mark(document)
                return _entry(system, document, read_ns), True
            return None, name in database.list_collection_names(filter={"name": name})

    def changes(self) -> Change:
        """Return what others changed since the last call; on a stream this waits for a second."""
        with self._told():
            if self._stream is None:
                with self._lock:
                    return self._look_at_all()
            changed = self._streamed(self._stream)
        read_ns, entries, gone = time.time_ns(), [], []
        with self._lock, self._told():
            if changed is None:
                return self._look_at_all()
            for system, topic in changed:
                document = self._db()[_collection(system)].find_one({"_id": topic}, _FIELDS)
                if document is None:
                    if self._seen.pop((system, topic), None) is not None:
                        gone.append((system, topic))
                elif (entry := self._news(system, document, read_ns)) is not None:
                    entries.append(entry)
        return Change(entries, gone, read_ns)

    def _open_stream(self) -> ChangeStream | None:
        from pymongo.errors import OperationFailure

        if self._streams:
            self._db()  # raises where it is not open
            try:
                return ChangeStream(self._client, self._database)
            except OperationFailure as error:
                log.info("%s has no change streams (%s); everything is read every %g s", self.url, error.code, POLL_S)
                self._streams = False
        return None

    def _streamed(self, stream: ChangeStream) -> list[Key] | None:
        """Wait for changes; the keys of what changed, or ``None`` where all may have."""
        found: dict[Key, None] = {}
        events = stream.take()
        if stream.ended:
            self._stream = self._open_stream()
            return None
        for event in events:
            where, key = event.get("ns", {}).get("coll"), event.get("documentKey", {}).get("_id", "")
            if where is None or "documentKey" not in event:
                return None
            if isinstance(key, str):
                found[unquote(where), key] = None
        return list(found)

    def _look_at_all(self) -> Change:
        began, read_ns = time.monotonic(), time.time_ns()
        entries: list[Entry] = []
        there: set[Key] = set()
        database = self._db()
        for name in database.list_collection_names():
            system = unquote(name)
            for document in database[name].find({}, _FIELDS):
                there.add((system, document["_id"]))
                entry = self._news(system, document, read_ns)
                if entry is not None:
                    entries.append(entry)
        gone = [key for key in self._seen if key not in there]
        for key in gone:
            del self._seen[key]
        self._pause_s = max(POLL_S, _POLL_SHARE * (time.monotonic() - began))
        return Change(entries, gone, read_ns)

    def _news(self, system: str, document: dict[str, Any], read_ns: int) -> Entry | None:
        """Return the entry of a document, if it differs from the one seen or written last."""
        key, mark = (system, document["_id"]), _mark(document)
        if self._seen.get(key) == mark or not isinstance(key[1], str):
            return None
        self._seen[key] = mark
        return _entry(system, document, read_ns)

    def write(self, entries: list[Entry], depth: int) -> dict[Key, str]:
        """Keep entries; each is acknowledged by the server when this returns."""
        from bson.errors import BSONError
        from pymongo.errors import DocumentTooLarge, OperationFailure

        bad: dict[Key, str] = {}
        with self._lock, self._told():
            for entry in entries if depth else {entry.key: entry for entry in entries}.values():
                try:
                    self._write(entry, depth)
                except (BSONError, DocumentTooLarge, OverflowError, UnicodeError) as error:
                    bad[entry.key] = str(error)
                except OperationFailure as error:
                    if error.code != _INVALID_NAMESPACE:
                        raise
                    bad[entry.key] = str(error)
        return bad

    def _write(self, entry: Entry, depth: int) -> None:
        from pymongo.errors import DuplicateKeyError

        collection = self._db()[_collection(entry.system)]
        there = collection.find_one({"_id": entry.topic})
        before = _entry(entry.system, there, 0) if there is not None else None
        history = list((there or {}).get("history") or ())
        if before is not None and before.order == entry.order:
            return
        if before is not None and before.order > entry.order:
            if depth:
                history = _sorted([*history, _document(entry)])[:depth]
                collection.update_one({"_id": entry.topic}, {"$set": {"history": history}})
            return
        if depth and before is not None:
            history = _sorted([*history, _document(before)])
        update = {**_document(entry), "history": history[:depth]}
        with contextlib.suppress(DuplicateKeyError):  # a later one came there in between
            collection.update_one(
                {"_id": entry.topic, "$nor": [{"version": {"$gt": entry.version}}]}, {"$set": update}, upsert=True
            )
            self._seen[entry.key] = _mark(update)

    def remove(self, keys: list[Key]) -> None:
        """Forget topics."""
        with self._lock, self._told():
            for system, topic in keys:
                self._db()[_collection(system)].delete_one({"_id": topic})
                self._seen.pop((system, topic), None)

    def history(self, key: Key) -> list[Entry]:
        """Return the values before the last one, newest first."""
        system, topic = key
        with self._told():
            document = self._db()[_collection(system)].find_one({"_id": topic}) or {}
        found = [_entry(system, {**value, "_id": topic}, 0) for value in document.get("history") or ()]
        return [entry for entry in found if entry is not None]

    def close(self) -> None:
        """Disconnect from the database."""
        self._stream = None
        if self._client is not None:
            self._client.close()
            self._client = None

    def _db(self) -> Any:
        if self._client is None:
            raise StoreUnavailable(self.url, "is not open")
        return self._client[self._database]

    @contextlib.contextmanager
    def _told(self) -> Iterator[None]:
        from pymongo.errors import PyMongoError

        try:
            yield
        except PyMongoError as error:
            text = str(error).partition(", Timeout")[0].partition(" (configured")[0]
            raise StoreUnavailable(self.url, f"does not answer or refuses: {text}") from error


def _collection(system: str) -> str:
    """Return a valid collection name: no dollar, no dot at an end or next to another, none of the database's
    own names.
    """
    name = quote(system, safe=" ()+,=@[]{}-_~")
    odd = name.startswith((".", "system.")) or name.endswith(".") or ".." in name
    return name.replace(".", "%2E") if odd else name


def _document(entry: Entry) -> dict[str, Any]:
    text = entry.text
    return {
        "data": entry.data if text is None else text,
        "version": entry.version,
        "stamp_ns": entry.stamp_ns,
        "origin": entry.origin,
        "type": entry.type,
        "form": entry.form,
    }


def _mark(document: dict[str, Any]) -> int:
    """Return a number that changes with the value of a document."""
    return hash(repr([document.get(key) for key in ("data", "version", "origin", "type", "form")]))


def _entry(system: str, document: dict[str, Any], read_ns: int) -> Entry | None:
    """Return the value of a document; if another program left out the version it is 0, and the stamp is the time of
    reading.
    """
    topic, data = document.get("_id"), document.get("data")
    if not isinstance(topic, str) or data is None:
        return None
    if isinstance(data, bytes):
        raw = bytes(data)
    else:
        raw = (data if isinstance(data, str) else json.dumps(data, default=str)).encode()
    version, stamp_ns = _number(document.get("version")), _number(document.get("stamp_ns"))
    if version > latest_version(read_ns or time.time_ns()):
        version = 0  # no clock made it
    if not version or not stamp_ns:
        stamp_ns = read_ns
    words = [str(document.get(key) or "") for key in ("origin", "type", "form")]
    return Entry(system, topic, raw, version, stamp_ns, words[0] or FOREIGN, words[1], words[2])


def _number(value: object) -> int:
    """Return a whole number of up to 62 bits, or 0 for anything else."""
    return int(value) if isinstance(value, int) and not isinstance(value, bool) and 0 < value < 1 << 62 else 0


def _sorted(documents: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(documents, key=lambda d: (d.get("version", 0), d.get("origin", "")), reverse=True)
