"""Keeps what one client serves: each name once, no more than a client may have, and withdrawn with it."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, TypeVar

from ropeway.errors import InvalidOperation, InvalidTypeName, RopewayError
from ropeway.networks.rosbridge.protocol import ops
from ropeway.networks.rosbridge.server.bodies import codec_of, known_type_of

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.server.host import SessionHost

__all__ = ["ClientOffer", "Offers"]


class ClientOffer(Protocol):
    """A service or an action that a client serves; ``name`` is its name on the graph."""

    name: str
    type: str

    async def open(self) -> None:
        """Serve it on the graph. Raises what the graph raises."""

    async def close(self, reason: str) -> None:
        """Stop serving it; what is under way fails for ``reason``."""


O = TypeVar("O", bound=ClientOffer)  # noqa: E741  # an offer


class Offers(dict[str, O]):
    """The services or actions (``kind``) of one client, by the names that it gave, at most ``limit``.

    ``group`` is that of their types, ``parts`` are the messages of which those are made.
    """

    def __init__(self, session: SessionHost, kind: str, group: str, parts: tuple[str, ...], limit: int) -> None:
        super().__init__()
        self._session, self._kind, self._group = session, kind, group
        self._parts, self._limit = parts, limit

    async def add(
        self,
        op: ops.AdvertiseService | ops.AdvertiseAction,
        make: Callable[[str, str], O],
        restart: Callable[[O], None],
    ) -> None:
        """Serve what the client advertises: ``make`` it of its name and type, or ``restart`` what it has already."""
        session, kind = self._session, self._kind
        _, given = op.about
        name = session.names.resolve(given)
        session.access.check(op.op, name)
        type = await known_type_of(session, op.type, self._group)
        if type.split("/")[1] != self._group:
            raise InvalidTypeName(op.type)
        session.learn(type, op.ropeway)
        for part in self._parts:
            codec_of(session, f"{type}_{part}")  # what the client cannot read, it cannot serve
        known = self.get(given)
        if known is None and len(self) >= self._limit:
            raise InvalidOperation("", f"a client may have {self._limit} {kind}s at most")
        if known is not None:
            session.complain(op.op, given, f"Duplicate {kind} advertised. Overwriting {given}.", op.id)
            if known.type == type:  # the name stays taken meanwhile
                restart(known)
                return
            del self[given]
            await known.close("it was advertised again with another type")
        offer = self[given] = make(name, type)
        try:
            await offer.open()
        except (RopewayError, ValueError):
            del self[given]
            raise

    async def withdraw(self, given: str) -> None:
        """Withdraw one."""
        offer = self.pop(given, None)
        if offer is None:
            what = f"{self._kind.capitalize()} {given}"
            raise InvalidOperation("", f"{what} has not been advertised via rosbridge, can't unadvertise.")
        await offer.close("its provider has withdrawn it")

    def found(self, given: str) -> O:
        """Return the one that the client means. Raises ``InvalidOperation``."""
        offer = self.get(given)
        if offer is None:
            name = self._session.names.resolve(given)
            offer = next((other for other in self.values() if other.name == name), None)
        if offer is None:
            raise InvalidOperation("", f"{self._kind.capitalize()} {given} has not been advertised via rosbridge.")
        return offer

    async def leave(self) -> None:
        """Withdraw all: the client has left."""
        for offer in list(self.values()):
            await offer.close("its provider has left")
        self.clear()
