"""Finds the links in the status of a gateway: of its remotes, and each one of a group or of several interfaces."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import Any

__all__ = ["each_link"]


def each_link(remotes: Iterable[Mapping[str, Any]]) -> Iterator[tuple[str, Mapping[str, Any]]]:
    """Yield the name of every link and its state as JSON: an address, with the interface where there are several."""
    for remote in remotes:
        members = remote.get("members")
        if not isinstance(members, list) or not members:
            yield str(remote["address"]), remote
            continue
        for member in members:
            interface = member.get("interface")
            yield (f"{remote['address']} ({interface})" if interface else str(member.get("address", ""))), member
