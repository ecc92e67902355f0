"""The journal as the manager uses it: in a thread, beside the file that the gateway was started with."""

from __future__ import annotations

import asyncio
import hashlib
import logging
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from ropeway.control.caller import Caller
from ropeway.errors import ControlRefused, JournalError
from ropeway.gateway.config.config import Config
from ropeway.gateway.journal import Journal, JournalEntry
from ropeway.gateway.plan import ConfigPlan

__all__ = ["ChangeRecord", "file_digest"]

log = logging.getLogger("ropeway.control")

T = TypeVar("T")

_LONGEST_NOTE: int = 2_000


def file_digest(file: Path | None) -> str:
    """Return a digest of what a file holds, ``""`` where it cannot be read."""
    try:
        return "" if file is None else hashlib.sha256(file.read_bytes()).hexdigest()
    except OSError:
        return ""


class ChangeRecord:
    """Keeps what is remembered of changes; without a journal nothing is, and nobody can go back.

    ``part`` is the name of the gateway in a file that has many.
    """

    def __init__(self, journal: Journal | None, file: Path | None = None, part: str = "") -> None:
        self.journal, self.file, self.part = journal, file, part
        self._seen = file_digest(file)
        self._turn = asyncio.Lock()

    def file_changed(self, *, seen: bool = False) -> bool:
        """Return whether the file is another than when it was applied last; with ``seen`` it is from now on."""
        found = file_digest(self.file)
        changed = bool(found) and found != self._seen
        if seen and found:
            self._seen = found
        return changed

    async def begin(
        self, config: Config, plan: ConfigPlan, caller: Caller, action: str, note: str
    ) -> JournalEntry | None:
        """Write down what is about to be done. Raises ``JournalError``, as of a full disk."""
        if self.journal is None:
            return None
        source = "" if self.file is None else str(self.file)
        steps = tuple(step.to_json() for step in plan.steps)

        def write(journal: Journal) -> JournalEntry:
            entry = JournalEntry(
                caller.name,
                caller.where,
                action,
                source,
                file_digest(self.file),
                config.etag,
                note[:_LONGEST_NOTE],
                steps,
            )
            return journal.begin(entry, config.to_json())

        return await self._do(write)

    async def confirm(self, entry: JournalEntry | None) -> None:
        """Write down that it runs."""
        if entry is not None:
            await self._do(lambda journal: journal.confirm(entry.number))

    async def fail(self, entry: JournalEntry | None, why: str) -> None:
        """Write down that it does not, where that is possible."""
        if entry is None:
            return
        try:
            await self._do(lambda journal: journal.fail(entry.number, why[:_LONGEST_NOTE]))
        except JournalError as error:
            log.error("%s", error)

    async def history(self, count: int, before: int | None) -> list[JournalEntry]:
        """Return the last entries, the newest first."""
        return await self._do(lambda journal: journal.history(count=count, before=before))

    async def entry(self, number: int) -> JournalEntry:
        """Return an entry. Raises ``ControlRefused`` where there is none."""
        found = await self._do(lambda journal: journal.entry(number))
        if found is None:
            raise ControlRefused(404, f"the journal has no entry {number}; ropeway config history lists them")
        return found

    async def entry_to_go_back_to(self, number: int | None, etag: str) -> JournalEntry:
        """Return the entry of a number, or the last one that ran with another configuration than this."""
        if number is not None:
            return await self.entry(number)

        def find(journal: Journal) -> JournalEntry | None:
            before: int | None = None
            while (entry := journal.last_up(before)) is not None and entry.etag == etag:
                before = entry.number
            return entry

        found = await self._do(find)
        if found is None:
            raise ControlRefused(404, "there is nothing to go back to: no other configuration has run")
        return found

    async def config(self, entry: JournalEntry) -> dict[str, Any]:
        """Return the configuration of an entry."""
        return await self._do(lambda journal: journal.config(entry))

    async def config_of(self, etag: str) -> Mapping[str, Any] | None:
        """Return the configuration of an etag, if it is remembered."""
        if self.journal is None:
            return None
        try:
            return await self._do(lambda journal: journal.content(etag))
        except JournalError:
            return None

    async def close(self) -> None:
        """Close the journal, after what is being written."""
        async with self._turn:
            if self.journal is not None:
                journal, self.journal = self.journal, None
                await asyncio.to_thread(journal.close)

    async def _do(self, work: Callable[[Journal], T]) -> T:
        """Run work in a thread, one after the other. Raises ``ControlRefused`` where there is no journal."""
        async with self._turn:
            if self.journal is None:
                raise ControlRefused(404, "nothing is remembered here: gateway.control.remember is false, or it failed")
            return await asyncio.to_thread(work, self.journal)
