"""Decides what a gateway starts with: its file, or what was applied to it while it ran.

The newer wins. A change is newer than the file as long as the file is as it was when the change was made. What did
not come up is not restored: the change before it is, and then the file.
"""

from __future__ import annotations

import getpass
import logging
import os
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from ropeway.audit.note import AuditNote, Auditor
from ropeway.control.caller import Caller
from ropeway.control.record import ChangeRecord, file_digest
from ropeway.errors import ConfigError, JournalError
from ropeway.gateway.config.config import Config, parse
from ropeway.gateway.journal import Journal, JournalEntry
from ropeway.gateway.plan import ConfigPlan, make_plan
from ropeway.gateway.state_place import default_journal

__all__ = ["Candidate", "audit_start", "candidates", "note_start", "open_record"]

log = logging.getLogger("ropeway.control")

_MOST_TRIED: Final = 3  # changes that ran once and do not come up now: a network is gone, and no older one helps


@dataclass(frozen=True, slots=True)
class Candidate:
    """A configuration that may be started, with the entry that it comes from; ``None`` for the file."""

    config: Config
    entry: JournalEntry | None = None


def open_record(config: Config) -> ChangeRecord:
    """Open what is remembered of a gateway; whatever is wrong with it is a warning, and the file counts."""
    control = config.gateway.control
    file = Path(config.source).resolve() if config.source and Path(config.source).exists() else None
    if not control.enabled or not control.remember or file is None:
        return ChangeRecord(None, file, config.part)
    path = Path(control.journal).expanduser() if control.journal else None
    try:
        journal = Journal(path or default_journal(control.name or config.gateway.name, str(file)))
    except JournalError as error:
        log.warning("%s; changes are not remembered", error)
        return ChangeRecord(None, file, config.part)
    if journal.set_aside is not None:
        log.warning("the journal was damaged; it is kept as %s, and a new one begins with %s", journal.set_aside, file)
    return ChangeRecord(journal, file, config.part)


def candidates(config: Config, record: ChangeRecord) -> list[Candidate]:
    """Return what to start, the first one first; says in the log which wins, and why."""
    own = Candidate(config)
    journal = record.journal
    if journal is None:
        return [own]
    try:
        last = journal.last_up()
        if last is None or last.etag == config.etag:
            return [own]
        when = time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(last.time_s))
        said = f"change {last.number} ({last.action} by {last.who}, {when})"
        if last.file_digest != file_digest(record.file):
            log.warning(
                "%s has changed since %s; the file wins. ropeway config rollback %d goes back",
                config.source,
                said,
                last.number,
            )
            return [own]
        log.warning(
            "%s is restored: %s is as it was then. ropeway config apply %s goes back to the file",
            said,
            config.source,
            config.source,
        )
        return [*_restored(journal, last, config.source), own]
    except JournalError as error:
        log.warning("%s; the gateway starts with %s", error, config.source)
        return [own]


def _restored(journal: Journal, last: JournalEntry, source: str) -> list[Candidate]:
    found: list[Candidate] = []
    entry: JournalEntry | None = last
    etags: set[str] = set()
    while entry is not None and len(etags) < _MOST_TRIED:
        if entry.etag not in etags and entry.file_digest == last.file_digest:
            etags.add(entry.etag)
            try:
                found.append(Candidate(parse(journal.config(entry), source), entry))
            except (ConfigError, JournalError) as error:  # of an older version, or a file that it names is gone
                log.warning("change %d cannot be restored: %s", entry.number, error)
        entry = journal.last_up(entry.number)
    return found


def note_start(record: ChangeRecord, started: Candidate, failed: list[tuple[Candidate, str]]) -> None:
    """Write down what came up, and what did not; a journal that cannot be written is a warning."""
    journal = record.journal
    if journal is None:
        return
    try:
        for candidate, why in failed:
            if candidate.entry is not None:
                journal.fail(candidate.entry.number, f"did not come up at a start: {why}")
        last, digest = journal.last_up(), file_digest(record.file)
        if last is not None and (last.etag, last.file_digest) == (started.config.etag, digest):
            return
        caller = _starter()
        steps: ConfigPlan | None = None
        if last is not None:
            try:
                steps = make_plan(parse(journal.config(last)), started.config)
            except ConfigError:  # what it was compared with cannot be read any more
                steps = None
        entry = JournalEntry(
            caller.name,
            caller.where,
            "start",
            str(record.file),
            digest,
            started.config.etag,
            plan=() if steps is None else tuple(step.to_json() for step in steps.steps),
        )
        journal.confirm(journal.begin(entry, started.config.to_json()).number)
    except JournalError as error:
        log.warning("%s; this start is not remembered", error)


def audit_start(audit: Auditor, started: Candidate) -> None:
    """Tell the audit log who has started the gateway, and with what."""
    caller, entry = _starter(), started.entry
    details = {"etag": started.config.etag, **({} if entry is None else {"number": entry.number})}
    audit.note(AuditNote("change", "start", started.config.source, caller.name, caller.where, details=details))


def _starter() -> Caller:
    try:
        name = getpass.getuser()
    except (KeyError, OSError):
        name = f"user {os.geteuid()}"
    return Caller(name, "ropeway run")
