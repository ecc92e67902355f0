"""``service info`` as text."""

from __future__ import annotations

from ropeway.cli.listing import info_json
from ropeway.cli.service.info import info_text
from ropeway.graph.calls import ProviderInfo, ServiceInfo

TYPE = "std_srvs/srv/Empty"
INFO = ServiceInfo(
    "/reset",
    (TYPE,),
    (ProviderInfo("/turtle"), ProviderInfo(gateway="cloud")),
    (ProviderInfo("/us", local=True), ProviderInfo()),
)


def test_info() -> None:
    """Type and counts stand on three lines, ours left out."""
    assert info_text(INFO) == f"Type: {TYPE}\nClients count: 1\nServices count: 2"
    assert info_text(ServiceInfo("/x", (TYPE, "a/srv/B"))).startswith(f"Type: ['{TYPE}', 'a/srv/B']\n")


def test_verbose_info() -> None:
    """Those who serve and call are named."""
    assert info_text(INFO, verbose=True) == (
        f"Type: {TYPE}\nClients count: 1\n    a participant without a node\n"
        "Services count: 2\n    node /turtle\n    gateway cloud"
    )


def test_json() -> None:
    """The JSON form has nodes and gateways."""
    assert info_json(INFO) == {
        "name": "/reset",
        "types": (TYPE,),
        "servers": [{"node": "/turtle", "gateway": ""}, {"node": "", "gateway": "cloud"}],
        "clients": [{"node": "", "gateway": ""}],
    }
