"""ropeway.networks.zenoh.session_config: what Zenoh is told."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest

from ropeway.networks.zenoh.address import ZenohAddress, parse_address
from ropeway.networks.zenoh.session_config import make_config


def get(address: ZenohAddress, key: str) -> Any:
    """One setting of the configuration for an address."""
    return json.loads(make_config(address).get_json(key))


def test_defaults() -> None:
    """A session is a peer that asks the router of this machine, and goes on asking."""
    address = parse_address("zenoh", {})
    assert get(address, "mode") == "peer"
    assert get(address, "connect/endpoints") == ["tcp/localhost:7447"]
    assert get(address, "connect/exit_on_failure") is False
    assert get(address, "scouting/multicast/enabled") is False


def test_scouts() -> None:
    """A peer without a router finds others by multicast."""
    assert get(parse_address("zenoh:peer", {}), "scouting/multicast/enabled") is True


def test_tls_and_user(tmp_path: Path) -> None:
    """Certificates and the user of an address go where Zenoh has them; the password comes from its file."""
    secret = tmp_path / "secret"
    secret.write_text("hunter2\n")
    url = f"zenoh:tls/a:1?ca=ca.pem&certificate=me.pem&key=me.key&user=robot&password_file={secret}"
    address = parse_address(url, {})
    assert get(address, "transport/link/tls/root_ca_certificate") == "ca.pem"
    assert get(address, "transport/link/tls/connect_private_key") == "me.key"
    assert get(address, "transport/auth/usrpwd/user") == "robot"
    assert "hunter2" in str(make_config(address).get_json("transport/auth/usrpwd"))


def test_file_and_override(tmp_path: Path) -> None:
    """What a file says counts, and what the environment overrides counts more."""
    file = tmp_path / "zenoh.json5"
    file.write_text(
        '{mode: "peer", connect: {endpoints: ["tcp/192.0.2.1:7447"]}, transport: {link: {tx: {lease: 60000}}}}'
    )
    address = parse_address(
        "zenoh", {"ZENOH_SESSION_CONFIG_URI": str(file), "ZENOH_CONFIG_OVERRIDE": "transport/link/tx/lease=5000"}
    )
    assert get(address, "connect/endpoints") == ["tcp/192.0.2.1:7447"]
    assert get(address, "transport/link/tx/lease") == 5000


def test_refused(tmp_path: Path) -> None:
    """A file or setting that cannot be used is told with its name."""
    broken = tmp_path / "broken.json5"
    broken.write_text("{mode: 7")
    for address, problem in (
        (ZenohAddress(0, config=str(broken)), "broken.json5"),
        (ZenohAddress(0, config=str(tmp_path / "missing.json5")), "missing.json5"),
        (ZenohAddress(0, override=(("no/such/key", "1"),)), "cannot be used"),
        (ZenohAddress(0, user="robot"), "password_file"),
        (ZenohAddress(0, user="robot", password_file=str(tmp_path / "none")), "none"),
    ):
        with pytest.raises(ValueError, match=problem):
            make_config(address)
