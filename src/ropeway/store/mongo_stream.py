"""Follows the changes in a MongoDB database, a batch of events at a time.

The driver's own change streams give one event at a time and wait for the next before they say that there is none, so
that whoever takes all that is there waits for as long as changes come.
"""

from __future__ import annotations

from typing import Any, Final

__all__ = ["ChangeStream"]

_AWAIT_MS: Final = 1000


class ChangeStream:
    """The changes of a database from now on. What the server refuses or breaks off raises ``PyMongoError``."""

    def __init__(self, client: Any, database: str) -> None:
        self._database = client[database]
        self._session = client.start_session()  # a cursor belongs to the session that made it
        order = {"aggregate": 1, "pipeline": [{"$changeStream": {}}], "cursor": {}}
        self._cursor = self._database.command(order, session=self._session)["cursor"]

    @property
    def ended(self) -> bool:
        """Whether the database was dropped or renamed, after which no more events come."""
        return not self._cursor["id"]

    def take(self) -> list[dict[str, Any]]:
        """Return the events that are there, or those that come within a second."""
        first: list[dict[str, Any]] = self._cursor.pop("firstBatch", [])
        if first or self.ended:
            return first
        order = {"getMore": self._cursor["id"], "collection": "$cmd.aggregate", "maxTimeMS": _AWAIT_MS}
        self._cursor = self._database.command(order, session=self._session)["cursor"]
        return list(self._cursor["nextBatch"])
