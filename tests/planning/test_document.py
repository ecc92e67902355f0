"""Plans are read from documents strictly."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.planning.document import is_plan, parse_plan

TOPIC = {"name": "/color", "bytes": 305280, "hz": 60, "publishers": {"robot": 1}, "readers": {"cloud": 3}}
LINK = {"between": ["robot", "cloud"], "mbit": 100, "delay_ms": 10}


def problems(document: Any) -> dict[str, str]:
    """Return the problems of a document by path."""
    with pytest.raises(ConfigError) as caught:
        parse_plan(document)
    return dict(caught.value.problems)


def test_a_plan() -> None:
    """A document of links and topics is a plan."""
    plan = parse_plan({"links": [LINK], "topics": [{**TOPIC, "ratios": {"zip": 2.1}}]})
    assert plan.links[0].rate_bps == 100e6
    assert plan.links[0].hosts == {"robot", "cloud"}
    assert plan.topics[0].ratios == {"zip": 2.1}


def test_faults_have_their_path() -> None:
    """Every fault is told with its path, a mistyped key with the nearest."""
    found = problems({"links": [LINK], "topics": [{**TOPIC, "herz": 5}, {**TOPIC, "hz": 0}]})
    assert 'did you mean "hz"' in found["topics[0].herz"]
    assert "above 0" in found["topics[1].hz"]


def test_hosts_without_a_link() -> None:
    """A topic between hosts that no link joins is a fault."""
    found = problems({"links": [LINK], "topics": [{**TOPIC, "readers": {"laptop": 1}}]})
    assert found == {"topics[0]": "no link joins robot and laptop"}


def test_what_is_a_plan() -> None:
    """A configuration of a gateway is no plan."""
    assert is_plan({"links": []})
    assert not is_plan({"remotes": []})
    assert not is_plan([])
