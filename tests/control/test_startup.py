"""ropeway.control.startup: what a gateway starts with, its file or what was applied to it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ropeway.control.startup import Candidate, candidates, note_start, open_record
from ropeway.gateway.config.config import Config, load, parse
from ropeway.gateway.journal import JournalEntry
from tests.support.messages import STRING


class Place:
    """A configuration file and the journal beside it."""

    def __init__(self, directory: Path) -> None:
        self.file = directory / "robot.json"
        self.journal = directory / "robot.journal"
        self.write("/file")

    def document(self, *names: str) -> dict[str, Any]:
        items = [{"name": name, "type": STRING} for name in names]
        control = {"journal": str(self.journal)}
        gateway = {"name": "robot", "graphs": ["memory:start"], "listen": [], "control": control}
        return {"gateway": gateway, "remotes": [{"address": "ws://a:1", "publish": items}]}

    def write(self, *names: str) -> None:
        self.file.write_text(json.dumps(self.document(*names)))

    def config(self, *names: str) -> Config:
        return parse(self.document(*names), str(self.file))

    def start(self, *, fails: int = 0) -> list[str]:
        """Start as ``ropeway run`` does, where the first candidates do not come up; return the routes that run."""
        record = open_record(load(self.file))
        found = candidates(load(self.file), record)
        note_start(record, found[fails], [(one, "no such network") for one in found[:fails]])
        if record.journal is not None:
            record.journal.close()
        return [route.name for route in found[fails].config.routes()]

    def apply(self, *names: str, state: str = "up") -> None:
        """Change the running gateway, up to a state."""
        record = open_record(load(self.file))
        journal = record.journal
        assert journal is not None
        config = self.config(*names)
        digest = (journal.last_up() or JournalEntry("", "", "", "", "", "")).file_digest
        made = journal.begin(JournalEntry("ann", "x", "apply", str(self.file), digest, config.etag), config.to_json())
        if state == "up":
            journal.confirm(made.number)
        journal.close()


@pytest.fixture
def place(tmp_path: Path) -> Place:
    """A file that has been started once."""
    made = Place(tmp_path)
    assert made.start() == ["/file"]
    return made


def test_what_was_applied_is_restored(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """What was applied last is restored while the file is as it was, and the log says so."""
    place.apply("/file", "/more")
    place.apply("/applied")
    assert place.start() == ["/applied"]
    assert "is restored" in caplog.text
    assert "apply by ann" in caplog.text
    assert place.start() == ["/applied"]


def test_a_file_that_has_changed_wins(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """A file that was changed after the last change wins, and the log says how to go back."""
    place.apply("/applied")
    place.write("/edited")
    assert place.start() == ["/edited"]
    assert "the file wins. ropeway config rollback 2 goes back" in caplog.text
    place.apply("/again")
    assert place.start() == ["/again"]


def test_what_never_came_up_is_not_restored(place: Place) -> None:
    """A change that was under way when the process was killed is not restored; the one before is."""
    place.apply("/good")
    place.apply("/killed", state="pending")
    assert place.start() == ["/good"]


def test_what_does_not_come_up_any_more(place: Place) -> None:
    """If the last change does not come up, the one before is started, and later not tried in vain again."""
    place.apply("/good")
    place.apply("/bad")
    assert place.start(fails=1) == ["/good"]
    assert place.start() == ["/good"]
    place.apply("/worse")
    assert place.start(fails=2) == ["/file"]
    assert place.start() == ["/file"]


def test_a_damaged_journal(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """With a damaged journal the gateway starts with its file, and says where the old journal is."""
    place.apply("/applied")
    place.journal.write_bytes(b"nothing of a journal" * 500)
    assert place.start() == ["/file"]
    assert "the journal was damaged; it is kept as" in caplog.text


def test_a_journal_that_cannot_be(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """Where the journal cannot be opened, the gateway starts all the same, and says that nothing is remembered."""
    place.journal.unlink()
    place.journal.mkdir()
    assert place.start() == ["/file"]
    assert "changes are not remembered" in caplog.text


def test_nothing_is_remembered(tmp_path: Path) -> None:
    """There is no journal where the configuration says so, nor for one that is in no file."""
    place = Place(tmp_path)
    for control in (False, {"remember": False}):
        document = place.document("/a")
        document["gateway"]["control"] = control
        assert open_record(parse(document, str(place.file))).journal is None
    assert open_record(parse(place.document("/a"))).journal is None


def test_restarts_leave_no_entries(place: Place) -> None:
    """Starting again with what ran is no change."""
    for _ in range(3):
        place.start()
    record = open_record(load(place.file))
    assert record.journal is not None
    assert len(record.journal.history()) == 1
    record.journal.close()


def test_an_entry_that_cannot_be_read(place: Place, caplog: pytest.LogCaptureFixture) -> None:
    """A configuration that is no longer good, as a file that it names is gone, is passed over with the reason."""
    record = open_record(load(place.file))
    journal = record.journal
    assert journal is not None
    last = journal.last_up()
    assert last is not None
    entry = JournalEntry("ann", "x", "apply", "", last.file_digest, "strange")
    journal.confirm(journal.begin(entry, {"gateway": {"types": ["/no/such/place"]}}).number)
    found = candidates(load(place.file), record)
    assert [isinstance(one, Candidate) and one.config.routes()[0].name for one in found] == ["/file", "/file"]
    assert "cannot be restored" in caplog.text
    journal.close()
