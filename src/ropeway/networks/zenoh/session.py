"""A session of Zenoh that stands for one node of ROS 2, and the tokens by which it shows itself."""

from __future__ import annotations

import asyncio
import itertools
import logging
from collections.abc import Callable, Iterable
from dataclasses import replace
from typing import Any, Final, TypeVar

import zenoh

from ropeway import aio
from ropeway.errors import GraphUnavailable
from ropeway.limits import ZENOH_HASHES_PER_NAME
from ropeway.networks.zenoh.tokens import ZenohToken, data_key, enclave_of, gid_of
from ropeway.qos import QoS

__all__ = ["ZenohPresence", "ZenohSession"]

log = logging.getLogger("ropeway.zenoh")

_CLOSE_S: Final = 5.0
_OPEN_S: Final = 20.0  # Zenoh waits for routers in the background; what takes longer has failed

T = TypeVar("T")


class ZenohSession:
    """A node in ``domain``, called ``node``; ``name`` is that of the graph, for errors.

    ``on_token`` is told of each token that the node shows, and takes back.
    """

    def __init__(
        self, name: str, domain: int, node: str, gateway_id: str, on_token: Callable[[str, bool], None]
    ) -> None:
        self.name, self.domain, self.node = name, domain, node
        self.id = ""
        self._on_token = on_token
        self._gateway_id = gateway_id
        self._ids = itertools.count()
        self._node_id = ""
        self._raw: zenoh.Session | None = None
        self._shown: Any = None  # the token of the node, which lives as long as this does

    @property
    def raw(self) -> zenoh.Session:
        """The session of Zenoh's. Raises ``GraphUnavailable`` where it is closed."""
        if self._raw is None:
            raise GraphUnavailable(self.name, "is not open; call open() first")
        return self._raw

    async def open(self, config: zenoh.Config, on_id: Callable[[str], None]) -> None:
        """Start, and tell the id of the session before anything is shown; routers are looked for as long as it lasts.

        Raises ``GraphUnavailable``.
        """
        try:
            async with aio.timeout(_OPEN_S):
                self._raw = await asyncio.to_thread(zenoh.open, config)
        except zenoh.ZError as error:
            raise GraphUnavailable(self.name, f"Zenoh cannot start: {error}") from error
        except TimeoutError:
            raise GraphUnavailable(self.name, f"Zenoh did not start within {_OPEN_S:g} s; is a router there?") from None
        self.id = str(self._raw.info.zid())
        on_id(self.id)
        self._node_id = str(next(self._ids))
        self._shown = self.show(str(self.token("node", self._node_id)))

    async def close(self) -> None:
        """End the session and all that was declared in it."""
        raw, self._raw = self._raw, None
        if raw is None:
            return
        try:
            async with aio.timeout(_CLOSE_S):
                await asyncio.to_thread(raw.close)
        except zenoh.ZError as error:
            log.warning("%s: Zenoh did not close: %s", self.name, error)
        except TimeoutError:
            log.warning("%s: Zenoh did not close within %g s", self.name, _CLOSE_S)

    def next_id(self) -> str:
        """Return a number for another endpoint of the node."""
        return str(next(self._ids))

    def token(self, kind: str, id: str, *, copy: bool = False) -> ZenohToken:
        """Return the token of the node, or the beginning of that of one of its endpoints."""
        enclave = enclave_of(self._gateway_id, copy=copy)
        return ZenohToken(self.domain, self.id, self._node_id, id, kind, self.node, enclave)

    def key(self, name: str, type: str, type_hash: str) -> str:
        """Return the key of a topic or service; ``*`` stands for any hash."""
        return data_key(self.domain, name, type, type_hash)

    def show(self, token: str) -> Any:
        """Declare a token; the result goes to ``hide``. Raises ``GraphUnavailable``."""
        shown = self.attempt(lambda: self.raw.liveliness().declare_token(token))
        self._on_token(token, True)
        return shown

    def hide(self, token: str, shown: Any) -> None:
        """Take back a token."""
        self.undeclare(shown)
        self._on_token(token, False)

    def attempt(self, declare: Callable[[], T]) -> T:
        """Do something with Zenoh. Raises ``GraphUnavailable`` with what it says."""
        try:
            return declare()
        except zenoh.ZError as error:
            raise GraphUnavailable(self.name, str(error)) from error

    def undeclare(self, declared: Any) -> None:
        """Take back what was declared; a session that was closed has done so."""
        if self._raw is None:
            return
        try:
            declared.undeclare()
        except zenoh.ZError as error:
            log.debug("%s: %s", self.name, error)


class ZenohPresence:
    """The tokens of one endpoint: one for each hash under which its type is known on the network.

    A node of ROS 2 sees only endpoints with its own hash, so where two distributions share a network, an endpoint of
    ours shows itself to both. Other Ropeways, who read under any hash, know by a mark which are copies of the first.
    """

    def __init__(self, session: ZenohSession, kind: str, name: str, type: str, type_hash: str, qos: QoS) -> None:
        self.type_hash = type_hash
        self._session, self._kind, self._name, self._type, self._qos = session, kind, name, type, qos
        self._id = session.next_id()
        self._shown: dict[str, tuple[str, Any]] = {}  # by hash: the token, and what Zenoh knows it by
        self._add(type_hash)

    @property
    def hashes(self) -> tuple[str, ...]:
        """The hashes under which it shows itself, that of our own definition first."""
        return tuple(self._shown)

    def gid(self, type_hash: str) -> bytes:
        """Return the gid of the endpoint under one of its hashes."""
        return gid_of(self._shown[type_hash][0])

    def follow(self, wanted: Iterable[str]) -> tuple[set[str], set[str]]:
        """Show itself under these hashes, too, and no others; return those that are new and those that are gone."""
        keep = [self.type_hash, *sorted({*wanted} - {self.type_hash})][:ZENOH_HASHES_PER_NAME]
        gone, new = self._shown.keys() - set(keep), set(keep) - self._shown.keys()
        for type_hash in gone:
            self._session.hide(*self._shown.pop(type_hash))
        for type_hash in new:
            self._add(type_hash)
        return new, gone

    def close(self) -> None:
        """Withdraw the endpoint."""
        shown, self._shown = self._shown, {}
        for token, handle in shown.values():
            self._session.hide(token, handle)

    def _add(self, type_hash: str) -> None:
        begin = self._session.token(self._kind, self._id, copy=type_hash != self.type_hash)
        token = str(replace(begin, name=self._name, type=self._type, type_hash=type_hash, qos=self._qos))
        self._shown[type_hash] = (token, self._session.show(token))
