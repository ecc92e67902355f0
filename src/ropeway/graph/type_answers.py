"""Answers those who lack the definition of a type, with the service ``~/get_type_description``, as ROS 2 does."""

from __future__ import annotations

from collections.abc import Awaitable, Callable

from ropeway.graph.calls import Request, ServiceHandler
from ropeway.types import TypeRegistry
from ropeway.types.described import DESCRIPTION_SERVICE, DESCRIPTION_TYPE, answer_for

__all__ = ["offer_descriptions"]

Serve = Callable[[str, str, ServiceHandler], Awaitable[object]]
"""Offers a service, given its name, its type and what answers it."""


async def offer_descriptions(serve: Serve, node: str, registry: TypeRegistry) -> None:
    """Have ``serve`` offer the definitions of ``registry`` under the name of a ``node``.

    A type is asked for by its name and hash; unlike in ROS 2, the hash may be left out.
    """
    read, write = (registry.codec(f"{DESCRIPTION_TYPE}_{end}") for end in ("Request", "Response"))

    async def answer(request: Request) -> bytes:
        asked = read.decode(request.payload)
        return write.encode(answer_for(registry, asked))

    await serve(f"{node}/{DESCRIPTION_SERVICE}", DESCRIPTION_TYPE, answer)
