"""A client of control APIs: of a gateway of this user by its name, of a socket by its path, of an address over TCP.

with ControlClient.find("robot1") as client:
    print(client.get("/v1/status")["routes"])
"""

from __future__ import annotations

import json
import ssl
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs, urlsplit, urlunsplit

import httpx

from ropeway.control.place import SUFFIX, running, search_directories
from ropeway.errors import ConfigError, ControlRefused, ControlUnavailable

__all__ = ["ControlClient", "ControlTarget", "find_target", "fleet", "read_answer", "unavailable"]

_TIMEOUT_S: Final = 10.0
_APPLY_S: Final = 120.0
_ON_SOCKET: Final = "http://ropeway"  # a name that no other host has; nothing is looked up


@dataclass(frozen=True)
class ControlTarget:
    """The place of a control API. ``name`` is for people; ``socket`` is ``None`` for an address over TCP."""

    name: str
    url: str = _ON_SOCKET
    socket: Path | None = None
    headers: Mapping[str, str] = field(default_factory=dict, repr=False)
    context: ssl.SSLContext | bool = True

    def client(self, timeout_s: float = _TIMEOUT_S) -> httpx.Client:
        """Make a client for scripts and the command line."""
        transport = httpx.HTTPTransport(uds=None if self.socket is None else str(self.socket), verify=self.context)
        return httpx.Client(base_url=self.url, headers=self.headers, transport=transport, timeout=timeout_s)

    def async_client(self, timeout_s: float = _TIMEOUT_S) -> httpx.AsyncClient:
        """Make a client for programs with an event loop."""
        uds = None if self.socket is None else str(self.socket)
        transport = httpx.AsyncHTTPTransport(uds=uds, verify=self.context)
        return httpx.AsyncClient(base_url=self.url, headers=self.headers, transport=transport, timeout=timeout_s)


def fleet() -> list[ControlTarget]:
    """Return the gateways of this user that run on this machine: those whose sockets somebody answers."""
    return [ControlTarget(name, socket=path) for name, path in sorted(running().items()) if _answers(path)]


def find_target(where: str | None = None, *, token: str = "", ca: str = "", cert: str = "") -> ControlTarget:
    """Return the gateway of a name, of the path of a socket, or of an address (``https://host:port``).

    ``None`` or ``""`` is for the only one that runs here. ``cert`` is a file with a certificate and its key, which is
    shown over https. Raises ``ControlUnavailable``.
    """
    if where and where.startswith(("http://", "https://")):
        return _over_tcp(where, token, ca, cert)
    if where and ("/" in where or where.endswith(SUFFIX)):
        return ControlTarget(Path(where).name.removesuffix(SUFFIX), socket=Path(where))
    there = fleet()
    names = ", ".join(target.name for target in there) or "none"
    looked = ", ".join(map(str, search_directories()))
    if where:
        found = next((target for target in there if target.name == where), None)
        if found is None:
            text = f"no gateway of this name runs here (running: {names}; looked in {looked})"
            raise ControlUnavailable(where, text)
        return found
    if len(there) != 1:
        text = (
            f"several gateways run here, name one: {names}" if there else f"no gateway runs here (looked in {looked})"
        )
        raise ControlUnavailable("control", text)
    return there[0]


class ControlClient:
    """Asks a control API, and turns its errors into ours."""

    def __init__(self, target: ControlTarget, *, timeout_s: float = _TIMEOUT_S) -> None:
        self.target = target
        self._client = target.client(timeout_s)

    @classmethod
    def find(cls, where: str | None = None, *, token: str = "", ca: str = "", cert: str = "") -> ControlClient:
        """Make a client of what ``find_target`` finds."""
        return cls(find_target(where, token=token, ca=ca, cert=cert))

    def __enter__(self) -> ControlClient:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the connection."""
        self._client.close()

    def get(self, path: str, **query: Any) -> Any:
        """Return what is at a path."""
        return self.request("GET", path, query=query)

    def post(self, path: str, body: Any = None, *, headers: Mapping[str, str] | None = None) -> Any:
        """Have something done."""
        return self.request("POST", path, body={} if body is None else body, headers=headers)

    def put(self, path: str, body: Any, *, headers: Mapping[str, str] | None = None) -> Any:
        """Replace something."""
        return self.request("PUT", path, body=body, headers=headers)

    def delete(self, path: str, *, headers: Mapping[str, str] | None = None) -> Any:
        """Remove something."""
        return self.request("DELETE", path, body={}, headers=headers)

    def request(
        self,
        method: str,
        path: str,
        *,
        query: Mapping[str, Any] | None = None,
        body: Any = None,
        headers: Mapping[str, str] | None = None,
    ) -> Any:
        """Send a request and return the answer as JSON, or as text where it is none.

        Raises ``ControlRefused`` or ``ConfigError`` for an answer that is an error, ``ControlUnavailable`` where there
        is none.
        """
        content = None if body is None else json.dumps(body).encode()
        sent = dict(headers or {}) | ({} if content is None else {"content-type": "application/json"})
        wait_s = _TIMEOUT_S if method == "GET" else _APPLY_S
        try:
            answer = self._client.request(
                method, path, params=dict(query or {}), content=content, headers=sent, timeout=wait_s
            )
        except httpx.HTTPError as error:
            raise unavailable(self.target, error) from None
        return read_answer(answer)

    def events(self, *, after: int | None = None) -> Iterator[dict[str, Any]]:
        """Yield events as they happen, until the gateway ends; with ``after``, first those behind a number."""
        yield from self.stream("/v1/events/stream", **({} if after is None else {"after": after}))

    def stream(self, path: str, **query: Any) -> Iterator[dict[str, Any]]:
        """Yield what a stream of server-sent events tells, until the gateway ends."""
        try:
            with self._client.stream("GET", path, params=query, timeout=None) as answer:
                if answer.status_code != httpx.codes.OK:
                    answer.read()
                    read_answer(answer)
                for line in answer.iter_lines():
                    if line.startswith("data: "):
                        yield json.loads(line.removeprefix("data: "))
        except httpx.HTTPError as error:
            raise unavailable(self.target, error) from None


def unavailable(target: ControlTarget, error: httpx.HTTPError) -> ControlUnavailable:
    """Return the error to raise where a request got no answer."""
    where = str(target.socket or target.url)
    if isinstance(error, httpx.ConnectError):
        return ControlUnavailable(where, f"nobody answers there ({error}); is the gateway running?")
    if isinstance(error, httpx.TimeoutException):
        return ControlUnavailable(where, "no answer in time")
    return ControlUnavailable(where, f"the connection broke: {error or type(error).__name__}")


def read_answer(answer: httpx.Response) -> Any:
    """Return an answer that was read: as JSON, or as text where it is none.

    Raises ``ControlRefused`` or ``ConfigError`` for one that is an error.
    """
    plain = answer.headers.get("content-type", "").partition(";")[0] != "application/json"
    try:
        value = answer.text if plain else answer.json()
    except (ValueError, RecursionError):
        value = answer.text
    if answer.is_success:
        return value
    faults = value.get("problems") if isinstance(value, dict) else None
    if answer.status_code == httpx.codes.UNPROCESSABLE_ENTITY and isinstance(faults, list):
        problems = [(str(row.get("path")), str(row.get("problem"))) for row in faults if isinstance(row, dict)]
        if problems:
            raise ConfigError(problems)
    text = value.get("error", "") if isinstance(value, dict) else str(value)
    details = value if isinstance(value, dict) else {}
    raise ControlRefused(answer.status_code, text or f"HTTP {answer.status_code}", details, headers=answer.headers)


def _over_tcp(where: str, token: str, ca: str, cert: str) -> ControlTarget:
    parts = urlsplit(where)
    token = token or parse_qs(parts.query).get("token", [""])[0]
    url = urlunsplit((parts.scheme, parts.netloc, "", "", ""))
    context: ssl.SSLContext | bool = True
    if ca or cert:
        try:
            context = ssl.create_default_context(cafile=ca or None)
            if cert:
                context.load_cert_chain(cert)
        except (OSError, ssl.SSLError) as error:
            said = error.strerror or str(error)
            raise ControlUnavailable(where, f"cannot use {cert or ca}: {said}; expected PEM files") from None
    return ControlTarget(
        parts.netloc, url, headers={"authorization": f"Bearer {token}"} if token else {}, context=context
    )


def _answers(path: Path) -> bool:
    import socket

    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as probe:
        probe.settimeout(1.0)
        try:
            probe.connect(str(path))
        except OSError:
            return False
    return True
