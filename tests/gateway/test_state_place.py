"""ropeway.gateway.state_place: where a gateway keeps what outlives it."""

from __future__ import annotations

from pathlib import Path

import pytest

from ropeway.gateway.state_place import default_journal


def test_where_it_is(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Each file has a journal of its own, in the state directory of a service or of the user."""
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path))
    here, there = default_journal("robot", "a.json"), default_journal("robot", "b.json")
    assert here.parent == there.parent == tmp_path / "ropeway"
    assert here != there
    monkeypatch.setenv("STATE_DIRECTORY", "/var/lib/ropeway:/x")
    assert default_journal("robot", "a.json").parent == Path("/var/lib/ropeway")
