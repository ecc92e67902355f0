"""ropeway.gateway.link_rows: every link in the status of a gateway."""

from __future__ import annotations

from typing import Any

from ropeway.gateway.link_rows import each_link


def test_each_link_has_a_name() -> None:
    """A remote is a link; of a group each member is one, of several interfaces each of these."""
    remotes: list[dict[str, Any]] = [
        {"address": "ws://cloud:9090", "state": "connected"},
        {"address": "ws://a,ws://b", "members": [{"address": "ws://a"}, {"address": "ws://b"}]},
        {"address": "ws://c", "members": [{"interface": "wlan0"}, {"interface": "wwan0"}]},
        {"address": "overlay", "members": []},
    ]
    names = [name for name, _ in each_link(remotes)]
    assert names == ["ws://cloud:9090", "ws://a", "ws://b", "ws://c (wlan0)", "ws://c (wwan0)", "overlay"]
