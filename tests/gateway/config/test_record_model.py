"""ropeway.gateway.config.record_model: what is to be recorded."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config.config import parse
from ropeway.gateway.plan import make_plan
from ropeway.gateway.process.supervisor import slices


def record(value: Any, **settings: Any) -> Any:
    return parse({"gateway": {"name": "robot", "graphs": ["dds:0", "dds:1"], "record": value, **settings}})


def test_one_or_several() -> None:
    """A recorder alone is a list of one; all that it leaves out has a default, and its files fit into its room."""
    config = record({})
    (one,) = config.gateway.record
    assert (one.name, one.routes, one.topics, one.active, one.ring_s) == ("recording", ("*",), (), True, None)
    assert one.file_bytes == 512 << 20
    assert record({"keep_bytes": 16 << 20}).gateway.record[0].file_bytes == 2 << 20
    assert [made.name for made in record([{"name": "a"}, {"name": "b"}]).gateway.record] == ["a", "b"]
    assert parse(config.to_json()).gateway.record == config.gateway.record


@pytest.mark.parametrize(
    ("value", "path", "said"),
    [
        ([{"name": "a"}, {"name": "a"}], "gateway.record", "another name"),
        ({"name": "../a"}, "gateway.record", "names a directory"),
        ({"when": ["/a.b < 1"]}, "gateway.record", "ring_s"),
        ({"link_loss": True}, "gateway.record", "ring_s"),
        ({"ring_s": 5, "when": ["nonsense"]}, "gateway.record", "is not a condition"),
        ({"split_bytes": 8 << 20, "keep_bytes": 8 << 20}, "gateway.record", "two files"),
        ({"routes": [], "link_state": False}, "gateway.record", "nothing to record"),
        ({"graph": "dds:7"}, "gateway.record.graph", "dds:0"),
        ([{"graph": "dds:7"}], "gateway.record[0].graph", "dds:0"),
        ({"compression": "gzip"}, "gateway.record", "zstd"),
        ({"keep_bytes": 5}, "gateway.record", "expected a number from"),
        ({"comprssion": "zstd"}, "gateway.record", "did you mean"),
    ],
)
def test_mistakes(value: Any, path: str, said: str) -> None:
    """What makes no sense is told with its path and what to do."""
    with pytest.raises(ConfigError) as caught:
        record(value)
    assert any(where.startswith(path) and said in problem for where, problem in caught.value.problems), caught.value


def test_a_change_interrupts_no_route() -> None:
    """Recorders are changed while everything goes on."""
    plan = make_plan(record({}), record({"compression": "zstd"}))
    assert plan.restart == ()
    assert [(step.action, step.path) for step in plan.steps] == [("change", "gateway.record")]


def test_one_worker_reads_the_networks() -> None:
    """Each worker records what crosses its routes; topics of networks are recorded by the first alone."""
    config = record(
        [{"topics": ["/a"]}, {"name": "local", "topics": ["/b"], "routes": [], "link_state": False}], workers=2
    )
    first, second = (part.gateway.record for _, part in slices(config))
    assert [one.topics for one in first] == [("/a",), ("/b",)]
    assert [(one.name, one.topics) for one in second] == [("recording", ())]


def test_a_relative_directory(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A directory counts from the file that names it, or from the home directory of the user."""
    monkeypatch.setenv("HOME", str(tmp_path / "home"))

    def place(directory: str) -> str | None:
        return parse({"gateway": {"record": {"directory": directory}}}, directory=tmp_path).gateway.record[0].directory

    assert place("here") == str(tmp_path / "here")
    assert place("~/there") == str(tmp_path / "home" / "there")
    assert place("/else") == "/else"
