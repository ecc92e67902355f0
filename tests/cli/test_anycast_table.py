"""ropeway.cli.anycast.table: groups for people."""

from __future__ import annotations

from ropeway.cli.anycast.table import named


def test_names_of_machines() -> None:
    """Decisions name machines as the policy does, also where one address begins another."""
    names = {"ws://edge:90": "edge", "ws://edge:9090": "cloud"}
    text = "ws://edge:90 → ws://edge:9090: ws://other:9090 is gone"
    assert named(text, names) == "edge → cloud: ws://other:9090 is gone"
