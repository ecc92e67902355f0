"""``action info`` as text."""

from __future__ import annotations

from ropeway.cli.action.info import info_text
from ropeway.graph.calls import ActionInfo, ProviderInfo

TYPE = "example_interfaces/action/Fibonacci"
INFO = ActionInfo("/count", (TYPE,), (ProviderInfo("/server"), ProviderInfo(local=True)), (ProviderInfo(gateway="g"),))


def test_info() -> None:
    """Clients and servers are counted and named, ours left out."""
    assert info_text(INFO) == "Action: /count\nAction clients: 1\n    gateway g\nAction servers: 1\n    /server"


def test_types() -> None:
    """Types follow the names when asked for."""
    assert info_text(INFO, show_types=True).endswith(f"\n    /server [{TYPE}]")


def test_count() -> None:
    """The names can be left out."""
    assert info_text(INFO, count=True) == "Action: /count\nAction clients: 1\nAction servers: 1"
