"""Last values in MongoDB as the IoRT paper has them: a collection per system, a document per topic."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any, Final
from urllib.parse import quote, unquote, urlsplit

from ropeway.errors import StoreUnavailable
from ropeway.store.entry import Entry, Key

__all__ = ["MongoBackend"]

_TIMEOUT_MS: Final = 3000
_DUPLICATE: Final = 11000
_DATABASE: Final = "ropeway"


class MongoBackend:
    """Values in the database that ``url`` names (``ropeway`` where it names none), through pymongo.

    A document is ``{_id: TOPIC, data, version, stamp_ns, origin, type, form, history}``. Data that is text is text
    there, too. An entry never replaces a later one, also if several servers write.
    """

    def __init__(self, url: str) -> None:
        parts = urlsplit(url)
        self.url = parts._replace(netloc=parts.netloc.rpartition("@")[2]).geturl()  # no password in a log
        self._url = url
        self._database = parts.path.strip("/") or _DATABASE
        self._client: Any = None

    def open(self) -> None:
        """Connect; the server must answer within 3 s."""
        from pymongo import MongoClient  # a fifth of a second that only this needs

        self.close()
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
        """Every last value; documents that others put there are left alone."""
        found: list[Entry] = []
        with self._told():
            database = self._db()
            for name in database.list_collection_names():
                for document in database[name].find({"version": {"$exists": True}}):
                    entry = _entry(unquote(name), document)
                    if entry is not None:
                        found.append(entry)
        return found

    def write(self, entries: list[Entry], depth: int) -> None:
        """Keep entries; each is acknowledged by the server when this returns."""
        with self._told():
            for entry in entries if depth else {entry.key: entry for entry in entries}.values():
                self._write(entry, depth)

    def _write(self, entry: Entry, depth: int) -> None:
        from pymongo.errors import DuplicateKeyError

        collection = self._db()[_collection(entry.system)]
        there = collection.find_one({"_id": entry.topic})
        before = _entry(entry.system, there) if there is not None else None
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
                {"_id": entry.topic, "version": {"$lte": entry.version}}, {"$set": update}, upsert=True
            )

    def remove(self, keys: list[Key]) -> None:
        """Forget topics."""
        with self._told():
            for system, topic in keys:
                self._db()[_collection(system)].delete_one({"_id": topic})

    def history(self, key: Key) -> list[Entry]:
        """The values before the last one, newest first."""
        system, topic = key
        with self._told():
            document = self._db()[_collection(system)].find_one({"_id": topic}) or {}
        found = [_entry(system, {**value, "_id": topic}) for value in document.get("history") or ()]
        return [entry for entry in found if entry is not None]

    def close(self) -> None:
        """Disconnect."""
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
    """The name of a collection: no dollar, no dot at an end or beside another, not one of the database's own."""
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


def _entry(system: str, document: dict[str, Any]) -> Entry | None:
    data = document.get("data")
    version, stamp_ns = document.get("version"), document.get("stamp_ns")
    if not isinstance(data, (str, bytes)) or not isinstance(version, int) or not isinstance(stamp_ns, int):
        return None
    raw = data.encode() if isinstance(data, str) else bytes(data)
    words = [str(document.get(key) or "") for key in ("origin", "type", "form")]
    return Entry(system, str(document.get("_id")), raw, int(version), int(stamp_ns), *words)


def _sorted(documents: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return sorted(documents, key=lambda d: (d.get("version", 0), d.get("origin", "")), reverse=True)
