"""Finds last values for the verbs: at a gateway over HTTP, at a server of nodes, or in the files of a store."""

from __future__ import annotations

import base64
import json
import ssl
from collections.abc import Callable, Iterator
from fnmatch import fnmatchcase
from pathlib import Path
from queue import SimpleQueue
from typing import Annotated, Any, Final, Protocol, TypeVar
from urllib.error import HTTPError, URLError
from urllib.parse import parse_qs, quote, urlsplit
from urllib.request import HTTPRedirectHandler, HTTPSHandler, Request, build_opener

import typer

from ropeway.errors import ConnectFailed, StoreUnavailable
from ropeway.iort import Node, NodeError, kind_of
from ropeway.listener.http import without_token
from ropeway.store import Entry, make_backend

__all__ = ["AtOption", "CaOption", "StoreAccess", "TokenOption", "find_source", "key_of", "shown"]

T = TypeVar("T")

_TIMEOUT_S: Final = 10.0
_ERROR_BYTES: Final = 64 << 10  # of an answer that says what went wrong

AtOption = Annotated[
    str,
    typer.Option(
        "--at",
        envvar="ROPEWAY_STORE",
        help="A gateway (http://host:9090), a server of nodes (iort://host:7410), or a store itself: an SQLite file, "
        "a directory of JSON files, mongodb://host/database.",
    ),
]
TokenOption = Annotated[
    str, typer.Option("--token", envvar="ROPEWAY_TOKEN", help="The token to show to the gateway.", show_default=False)
]
CaOption = Annotated[
    str, typer.Option("--ca", help="File of the authorities to trust, for https and iorts.", show_default=False)
]


class StoreAccess(Protocol):
    """Gives access to stored values. All methods block; they raise ``RopewayError``."""

    def values(self, system: str, topic: str) -> list[dict[str, Any]]:
        """Return the values whose names match patterns, as JSON."""

    def get(self, system: str, topic: str, history: bool) -> list[dict[str, Any]]:
        """Return a value, with ``history`` those before it, too; empty if there is none."""

    def watch(self, system: str, topic: str) -> Iterator[dict[str, Any]]:
        """Yield the values that are there, and every later one."""

    def remove(self, system: str, topic: str) -> bool:
        """Forget a topic; false where it was not there."""

    def close(self) -> None:
        """Let go."""


def find_source(at: str, token: str, ca: str) -> StoreAccess:
    """Return what ``--at`` names; ``?token=`` in an address counts as ``--token``."""
    parts = urlsplit(at)
    scheme = parts.scheme
    if scheme in ("http", "https", "iort", "iorts") and parts.query:
        query = parse_qs(parts.query)
        token = token or [*query.pop("token", ()), *query.pop("access_token", ()), ""][0]
        if query:
            others = ", ".join(sorted(query))
            raise ConnectFailed(without_token(at), f"the address has no parameter but token, got {others}")
        at = parts._replace(query="").geturl()
    if scheme in ("http", "https"):
        return _Gateway(at.rstrip("/"), token, ca)
    if scheme in ("iort", "iorts"):
        return _Server(at, token, ca)
    return _Kept(at)


def key_of(name: str) -> tuple[str, str]:
    """Split ``SYSTEM/TOPIC``, with or without a leading slash."""
    system, _, topic = name.lstrip("/").partition("/")
    return system or "*", topic or "*"


def shown(value: dict[str, Any], limit: int = 80) -> str:
    """Return the data of a value on one line."""
    if "message" in value:
        text = json.dumps(value["message"])
    elif "data" in value:
        text = str(value["data"])
    elif "base64" in value:
        text = f"({len(base64.b64decode(value['base64']))} bytes)"
    else:
        text = f"({value.get('bytes', 0)} bytes)"
    text = text.replace("\n", " ")
    return text if len(text) <= limit else f"{text[: limit - 1]}…"


class _NoRedirects(HTTPRedirectHandler):
    """Refuses to follow redirects: a token is for the host that was named."""

    def redirect_request(self, *_: Any) -> None:
        """Refuse to follow; see ``HTTPRedirectHandler``."""


class _Gateway:
    """Reads values from a gateway over HTTP."""

    def __init__(self, url: str, token: str, ca: str) -> None:
        self._url, self._token = url, token
        context = ssl.create_default_context(cafile=ca or None) if url.startswith("https") else None
        if context is not None and ca:  # Python 3.13 demands more of certificates than authorities of one's own put in
            context.verify_flags &= ~ssl.VERIFY_X509_STRICT
        self._opener = build_opener(_NoRedirects, HTTPSHandler(context=context))

    def _ask(self, path: str, method: str = "GET", timeout_s: float | None = _TIMEOUT_S) -> Any:
        headers = {"Authorization": f"Bearer {self._token}"} if self._token else {}
        request = Request(f"{self._url}{path}", method=method, headers=headers)  # noqa: S310 - http or https, see above
        try:
            return self._opener.open(request, timeout=timeout_s)
        except HTTPError as error:
            with error:
                raw = error.read(_ERROR_BYTES)
            missing = False
            try:
                said = json.loads(raw)
                text, missing = str(said["error"]), said.get("missing") is True
            except (ValueError, KeyError, TypeError):
                text = f"answered {error.code}"
                if 300 <= error.code < 400:
                    text += "; that is not followed: write the address that is meant"
            if missing:
                return None
            hint = '; it keeps no values: it needs an iort:// listener, a store, or a topic with "store": true'
            raise ConnectFailed(self._url, text + (hint if error.code == 404 else "")) from error
        except (URLError, OSError) as error:
            reason = error.reason if isinstance(error, URLError) else error
            raise ConnectFailed(self._url, f"{reason}; is a gateway running there? --at names another") from error

    def _json(self, path: str) -> Any:
        answer = self._ask(path)
        if answer is None:
            return None
        with answer:
            return json.loads(answer.read())

    def values(self, system: str, topic: str) -> list[dict[str, Any]]:
        """Return the values whose names match."""
        found = self._json("/store") or []
        return [v for v in found if fnmatchcase(v["system"], system) and fnmatchcase(v["topic"], topic)]

    def get(self, system: str, topic: str, history: bool) -> list[dict[str, Any]]:
        """Return a value."""
        found = self._json(f"{_path(system, topic)}{'?history=1' if history else ''}")
        return [] if found is None else found if isinstance(found, list) else [found]

    def watch(self, system: str, topic: str) -> Iterator[dict[str, Any]]:
        """Yield every value."""
        with self._ask(f"{_path(system, topic)}?watch=1", timeout_s=None) as lines:
            for line in lines:
                yield json.loads(line)

    def remove(self, system: str, topic: str) -> bool:
        """Forget a topic."""
        answer = self._ask(_path(system, topic), "DELETE")
        if answer is None:
            return False
        with answer:
            answer.read()
        return True

    def close(self) -> None:
        """Do nothing: no connection is held."""


class _Server:
    """Reads values as a node of a server."""

    def __init__(self, url: str, token: str, ca: str) -> None:
        self._url = url
        self._node = Node("ropeway", url, token=token or None, tls=ca or None, max_packet_bytes=64 << 20, kind="pc")
        if not self._node.wait_mode("remote", 5.0):
            error = self._node.last_error
            self._node.close()
            raise ConnectFailed(url, error)

    def values(self, system: str, topic: str) -> list[dict[str, Any]]:
        """Return the values whose names match."""
        return self._tried(lambda: self._node.list(system, topic))

    def get(self, system: str, topic: str, history: bool) -> list[dict[str, Any]]:
        """Return a value; a server of nodes has no history."""
        return self.values(system, topic)

    def watch(self, system: str, topic: str) -> Iterator[dict[str, Any]]:
        """Yield every value."""
        values: SimpleQueue[Any] = SimpleQueue()
        self._tried(lambda: self._node.subscribe(topic, values.put, system=system))
        while True:
            value = values.get()
            yield {
                "system": value.system,
                "topic": value.topic,
                "data": value.text,
                "type": value.type,
                "version": value.version,
                "stamp_ns": value.stamp_ns,
                "origin": value.origin,
                "kind": kind_of(value.origin),
                "age_s": round(value.age_s, 3),
            }

    def remove(self, system: str, topic: str) -> bool:
        """Forget a topic."""
        try:
            self._node.request(system, topic, "+del", {})
        except NodeError as error:
            if error.code == "unknown-topic":
                return False
            raise ConnectFailed(self._url, str(error)) from error
        return True

    def close(self) -> None:
        """Leave the server."""
        self._node.close()

    def _tried(self, work: Callable[[], T]) -> T:
        try:
            return work()
        except NodeError as error:
            raise ConnectFailed(self._url, str(error)) from error


class _Kept:
    """Reads the values of a store without a gateway."""

    def __init__(self, url: str) -> None:
        if "://" not in url and not Path(url).expanduser().exists():
            raise StoreUnavailable(url, "does not exist; --at names a gateway, a server of nodes, or a store")
        self._backend = make_backend(url)
        self._backend.open()

    def values(self, system: str, topic: str) -> list[dict[str, Any]]:
        """Return the values whose names match."""
        found = [e for e in self._backend.load() if fnmatchcase(e.system, system) and fnmatchcase(e.topic, topic)]
        return _as_json(sorted(found, key=lambda e: e.key))

    def get(self, system: str, topic: str, history: bool) -> list[dict[str, Any]]:
        """Return a value."""
        found = [e for e in self._backend.load() if e.key == (system, topic)]
        if found and history:
            found += self._backend.history((system, topic))
        return _as_json(found)

    def watch(self, system: str, topic: str) -> Iterator[dict[str, Any]]:
        """Refuse to watch: nothing reports changes here."""
        raise StoreUnavailable(self._backend.url, "is watched at a gateway or a server: --at http://… or iort://…")

    def remove(self, system: str, topic: str) -> bool:
        """Forget a topic; a gateway that runs on this store would write it again."""
        there = any(entry.key == (system, topic) for entry in self._backend.load())
        if there:
            self._backend.remove([(system, topic)])
        return there

    def close(self) -> None:
        """Let go."""
        self._backend.close()


def _as_json(entries: list[Entry]) -> list[dict[str, Any]]:
    from ropeway.listener.store_watcher import entry_json  # loads the message types, which other sources do not need
    from ropeway.types import TypeRegistry

    registry = TypeRegistry()
    return [entry_json(entry, registry) for entry in entries]


def _path(system: str, topic: str) -> str:
    path = f"/store/{quote(system, safe='*')}"
    return path if topic == "*" else f"{path}/{quote(topic, safe='*/')}"
