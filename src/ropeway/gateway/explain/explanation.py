"""Defines what an explanation consists of."""

from __future__ import annotations

import enum
from dataclasses import dataclass, field
from typing import Any

__all__ = ["Explanation", "Finding", "Subject"]


class Subject(enum.Enum):
    """The link of the chain that a finding is about."""

    ROUTE = "route"
    NETWORK = "network"
    SOURCE = "source"
    TYPE = "type"
    QOS = "qos"
    LINK = "link"
    RIGHTS = "rights"
    READERS = "readers"
    TRAFFIC = "traffic"


@dataclass(frozen=True, slots=True)
class Finding:
    """A fact about one link of the chain.

    ``ok`` is ``None`` where nobody can tell, or where it neither helps nor hinders. ``where`` names the graph or the
    remote, ``path`` the place in the configuration.
    """

    subject: Subject
    ok: bool | None
    text: str
    where: str = ""
    path: str = ""
    near: str = ""
    """A name that is there and may be meant."""

    def to_json(self) -> dict[str, Any]:
        """Return the finding as JSON."""
        return {
            "subject": self.subject.value,
            "ok": self.ok,
            "text": self.text,
            "where": self.where,
            "path": self.path,
            "near": self.near,
        }


@dataclass(frozen=True, slots=True)
class Explanation:
    """An answer about one name and one way: from ``source`` to ``target``."""

    name: str
    kind: str
    source: str
    target: str
    path: str = ""
    findings: tuple[Finding, ...] = field(default=())

    @property
    def crosses(self) -> bool:
        """Whether nothing is in the way."""
        return all(finding.ok is not False for finding in self.findings)

    def to_json(self) -> dict[str, Any]:
        """Return the explanation as JSON."""
        return {
            "name": self.name,
            "kind": self.kind,
            "source": self.source,
            "target": self.target,
            "path": self.path,
            "crosses": self.crosses,
            "findings": [finding.to_json() for finding in self.findings],
        }
