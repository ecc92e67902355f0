"""The table of what the control API offers. A file in ``control/resources`` adds to it; nothing else has to change.

A handler is ``async def handler(asked: ControlRequest) -> Any``. It returns a value that becomes JSON, or an
``Answer``::

    resources = Resources()

    @resources.get("/v1/links", right="observe", gives=list[LinkStatus])
    async def links(asked: ControlRequest) -> Any:
        \"\"\"Return all links.\"\"\"
        return ...
"""

from __future__ import annotations

import importlib
import pkgutil
from collections.abc import AsyncIterator, Awaitable, Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Literal

from pydantic import BaseModel

from ropeway.audit.note import AuditKind
from ropeway.control.caller import Caller

if TYPE_CHECKING:
    from ropeway.control.manager import Manager

__all__ = ["Answer", "Audited", "ControlRequest", "Handler", "Resource", "Resources", "Right", "collect"]


@dataclass(frozen=True, slots=True)
class Audited:
    """Says how the audit log calls a request: its operation, and the part of the path that has the name of its object.

    What asks for the right ``configure`` is of kind ``change``, and for ``operate`` of kind ``operate``, if not said
    otherwise.
    """

    operation: str
    name: str = ""
    kind: AuditKind | None = None


Right = Literal["observe", "configure", "operate"]
Method = Literal["GET", "POST", "PUT", "DELETE"]


@dataclass(frozen=True)
class ControlRequest:
    """A request that was admitted: ``body`` is what the resource takes, checked; ``path`` has the parts in braces."""

    manager: Manager
    caller: Caller
    path: Mapping[str, str] = field(default_factory=dict)
    query: Mapping[str, str] = field(default_factory=dict)
    headers: Mapping[str, str] = field(default_factory=dict)
    body: Any = None
    noted: dict[str, Any] = field(default_factory=dict)
    """Holds what the handler adds to the entry of the audit log: ``name``, and details."""


@dataclass(frozen=True)
class Answer:
    """An answer with more than a value. ``stream`` yields bytes, for as long as the reader wants; ``value`` bytes are
    sent as they are.
    """

    value: Any = None
    status: int = 200
    headers: Mapping[str, str] = field(default_factory=dict)
    media_type: str = "application/json"
    stream: AsyncIterator[bytes] | None = None


Handler = Callable[[ControlRequest], Awaitable[Any]]


@dataclass(frozen=True)
class Resource:
    """An entry of the table. ``takes`` is the model of the body, ``gives`` the type of the answer, for the document."""

    method: Method
    path: str
    right: Right
    handler: Handler
    takes: type[BaseModel] | None = None
    gives: Any = None
    media_type: str = "application/json"
    audited: Audited | None = None

    @property
    def summary(self) -> str:
        """The first paragraph of the handler's docstring."""
        text = (self.handler.__doc__ or "").strip().split("\n\n")[0]
        return " ".join(text.split())


class Resources:
    """The resources of one file."""

    def __init__(self) -> None:
        self.listed: list[Resource] = []

    def get(
        self, path: str, *, right: Right = "observe", gives: Any = None, media_type: str = "application/json"
    ) -> Callable[[Handler], Handler]:
        """Offer something to read."""
        return self._add("GET", path, right, None, gives, media_type)

    def post(
        self,
        path: str,
        *,
        right: Right,
        takes: type[BaseModel] | None = None,
        gives: Any = None,
        audited: Audited | None = None,
    ) -> Callable[[Handler], Handler]:
        """Offer something to do."""
        return self._add("POST", path, right, takes, gives, audited=audited)

    def put(
        self,
        path: str,
        *,
        right: Right,
        takes: type[BaseModel] | None = None,
        gives: Any = None,
        audited: Audited | None = None,
    ) -> Callable[[Handler], Handler]:
        """Offer something to replace."""
        return self._add("PUT", path, right, takes, gives, audited=audited)

    def delete(
        self, path: str, *, right: Right, gives: Any = None, audited: Audited | None = None
    ) -> Callable[[Handler], Handler]:
        """Offer something to remove."""
        return self._add("DELETE", path, right, None, gives, audited=audited)

    def _add(
        self,
        method: Method,
        path: str,
        right: Right,
        takes: type[BaseModel] | None,
        gives: Any,
        media_type: str = "application/json",
        audited: Audited | None = None,
    ) -> Callable[[Handler], Handler]:
        if method != "GET" and audited is None:
            audited = Audited(f"{method} {path}")

        def add(handler: Handler) -> Handler:
            self.listed.append(Resource(method, path, right, handler, takes, gives, media_type, audited))
            return handler

        return add


def collect() -> list[Resource]:
    """Return everything that the files in ``control/resources`` offer, sorted by path."""
    from ropeway.control import resources

    found: list[Resource] = []
    for module in pkgutil.iter_modules(resources.__path__, f"{resources.__name__}."):
        offered = getattr(importlib.import_module(module.name), "resources", None)
        if isinstance(offered, Resources):
            found += offered.listed
    return sorted(found, key=lambda resource: (resource.path, resource.method))
