"""Domains of this process, counted: Cyclone DDS has one per process and number, with one configuration."""

from __future__ import annotations

import logging
import threading
from dataclasses import dataclass
from typing import Final

from ropeway.errors import GraphUnavailable
from ropeway.networks.dds.profile import Profile
from ropeway.networks.dds.raw import PRECONDITION_NOT_MET, check, lib

__all__ = ["MAX_DOMAIN", "acquire", "release"]

log = logging.getLogger("ropeway.dds")

MAX_DOMAIN: Final = 232  # beyond, the port numbers of RTPS end


@dataclass
class _Domain:
    entity: int | None  # None: somebody else in this process made it, and keeps it
    profile: Profile
    users: int = 0


_domains: dict[int, _Domain] = {}
_lock = threading.Lock()


def acquire(graph: str, number: int, profile: Profile) -> None:
    """Make the domain, or share the one there is. Pair each call with ``release``.

    Raises ``GraphUnavailable`` where Cyclone DDS refuses, or where the domain is open with another configuration.
    """
    with _lock:
        domain = _domains.get(number)
        if domain is None:
            entity: int | None = lib.create_domain(number, profile.xml.encode())
            if entity == PRECONDITION_NOT_MET:
                log.warning("%s: this process has the domain already, so its transport settings are kept", graph)
                entity = None
            elif entity is not None and entity < 0:
                raise GraphUnavailable(graph, _refused(profile))
            domain = _domains[number] = _Domain(entity, profile)
        elif domain.profile != profile:
            raise GraphUnavailable(
                graph,
                f"this process has domain {number} open with {_described(domain.profile)}, "
                f"and a process has each domain once; use the same for all, not {_described(profile)}",
            )
        domain.users += 1


def release(number: int) -> None:
    """Give back what ``acquire`` gave; the last one takes the domain down, unless others in the process live on it."""
    with _lock:
        domain = _domains[number]
        domain.users -= 1
        if domain.users:
            return
        if domain.entity is not None:
            if check(lib.get_children(domain.entity, None, 0), "get_children") > 0:
                return
            check(lib.delete(domain.entity), "delete domain")
        del _domains[number]


def _described(profile: Profile) -> str:
    return f"interface {profile.interface}" if profile.interface else "the default interface"


def _refused(profile: Profile) -> str:
    where = f" on interface {profile.interface}" if profile.interface else ""
    return (
        f"Cyclone DDS cannot start{where} (it wrote why to stderr). Is the interface up and has it an address, "
        "are there fewer than 120 DDS processes in this domain on this machine, and is CYCLONEDDS_URI, where set, "
        "well-formed?"
    )
