"""ropeway.networks.overlay.zenoh_config: what Zenoh is told."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from ropeway.gateway.config.overlay_model import OverlayConfig
from ropeway.networks.overlay.zenoh_config import by_interface

ROUTERS = ["tls/a:7447", "quic/b:7447"]


def test_endpoints_by_interface() -> None:
    """Every router is tried by the first interface, then by the next; without interfaces the system decides."""
    assert by_interface(ROUTERS, []) == ROUTERS
    assert by_interface(ROUTERS, ["wlan0", "wwan0"]) == [
        "tls/a:7447#iface=wlan0",
        "quic/b:7447#iface=wlan0",
        "tls/a:7447#iface=wwan0",
        "quic/b:7447#iface=wwan0",
    ]


@pytest.mark.parametrize("name", ["", "wlan0;x", "wlan0#iface=lo", "a" * 16, "wlan 0"])
def test_what_is_no_interface(name: str) -> None:
    """A name that no interface has is refused, and cannot add anything to the endpoint."""
    with pytest.raises(ValidationError, match="network interface such as wlan0"):
        OverlayConfig.model_validate({"identity": __file__, "interfaces": [name]})
