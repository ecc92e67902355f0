"""Tables of the status of a gateway."""

from __future__ import annotations

import io
import time
from typing import Any

import pytest
from rich.console import Console, Group

from ropeway.cli.status.tables import tables
from ropeway.control.figures import duration

ROUTE = {
    "operation": "publish",
    "name": "/odom",
    "state": "idle",
    "publishers": 1,
    "readers": 0,
    "rate_hz": 0.0,
    "delay_ms": None,
    "bandwidth_bps": 0,
    "drops": {"older than its lifespan": 3},
    "encoding": "zstd",
    "error": "",
    "reason": "nobody reads /odom",
}
SESSION = {
    "peer": "10.0.0.7:5",
    "gateway": "",
    "dialect": "rosbridge",
    "role": "[all]",
    "topics": [1],
    "services": [],
    "bytes_in": 2_000_000,
    "bytes_out": 10,
    "denied": {},
    "agent": "Firefox",
}


def shown(status: dict[str, Any], width: int = 200) -> str:
    """Return the tables as text."""
    console = Console(width=width, file=io.StringIO(), record=True)
    console.print(Group(*tables(status)))
    return console.export_text()


def test_links_routes_and_clients() -> None:
    """The tables have a row per link, route and client, with the reason why nothing crosses."""
    remotes = [{"address": "ws://cloud:9090", "state": "connected", "rtt_ms": 70.4, "pace_bps": 5e6, "error": ""}]
    session = {**SESSION, "since": time.time() - 7300}
    text = shown({"name": "robot1", "remotes": remotes, "routes": [ROUTE], "sessions": [session]})
    assert "robot1: links" in text
    for word in ("70.4", "5.0", "/odom", "nobody reads /odom", "zstd", "10.0.0.7:5", "[all]", "2 h 1 min", "Firefox"):
        assert word in text


def test_members_of_a_group_have_rows() -> None:
    """A group has a row per member."""
    members = [{"address": "ws://a", "state": "connected"}, {"address": "ws://b", "state": "waiting to retry"}]
    text = shown(
        {"name": "r", "remotes": [{"address": "ws://a,ws://b", "members": members}], "routes": [], "sessions": []}
    )
    assert "ws://b" in text
    assert "routes" not in text


def test_narrow_terminals() -> None:
    """A narrow terminal keeps what matters: the name, the state and the reason."""
    text = shown({"name": "r", "remotes": [], "routes": [ROUTE], "sessions": []}, width=50)
    assert "nobody reads /odom" in text
    assert "zstd" not in text


@pytest.mark.parametrize(
    ("seconds", "text"), [(-1, "0 s"), (59, "59 s"), (61, "1 min 1 s"), (7300, "2 h 1 min"), (200_000, "2 d 7 h")]
)
def test_durations(seconds: float, text: str) -> None:
    """Time spans are told in their two largest units."""
    assert duration(seconds) == text
