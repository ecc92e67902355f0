"""ropeway.networks.zenoh.address: how a network on rmw_zenoh is written."""

from __future__ import annotations

import pytest

from ropeway.networks.zenoh.address import ZenohAddress, parse_address

_LOCAL = ("tcp/localhost:7447",)
_LISTEN = ("tcp/localhost:0",)


def test_alone() -> None:
    """``zenoh`` alone is a peer beside the router of this machine, as the nodes of rmw_zenoh are."""
    assert parse_address("zenoh", {}) == ZenohAddress(0, _LOCAL, _LISTEN, "peer")
    assert parse_address("zenoh:", {}) == parse_address("zenoh", {})


def test_domain() -> None:
    """The domain is that of ``ROS_DOMAIN_ID`` unless the address names one."""
    assert parse_address("zenoh", {"ROS_DOMAIN_ID": "7"}).domain == 7
    assert parse_address("zenoh?domain=9", {"ROS_DOMAIN_ID": "7"}).domain == 9


def test_endpoints() -> None:
    """Routers are named as Zenoh does, several with commas between; ``peer`` has none and finds others by itself."""
    found = parse_address("zenoh:tcp/10.0.0.1:7447,tls/router.example:7448?mode=client&listen=tcp/0.0.0.0:7449", {})
    assert found.connect == ("tcp/10.0.0.1:7447", "tls/router.example:7448")
    assert (found.mode, found.listen, found.scout) == ("client", ("tcp/0.0.0.0:7449",), False)
    peer = parse_address("zenoh:peer", {})
    assert (peer.connect, peer.scout) == ((), True)


def test_file() -> None:
    """A configuration file says what the address does not."""
    found = parse_address("zenoh?config=zenoh.json5&user=robot&password_file=secret", {})
    assert found == ZenohAddress(0, None, None, "", "zenoh.json5", user="robot", password_file="secret")
    assert parse_address("zenoh:tcp/a:1?config=zenoh.json5", {}).connect == ("tcp/a:1",)


def test_environment() -> None:
    """Where the address names nothing, what the environment tells rmw_zenoh counts; else it does not."""
    environ = {
        "ZENOH_SESSION_CONFIG_URI": "/etc/zenoh.json5",
        "ZENOH_CONFIG_OVERRIDE": 'mode="client";scouting/delay=1',
    }
    found = parse_address("zenoh", environ)
    assert (found.config, found.connect) == ("/etc/zenoh.json5", None)
    assert found.override == (("mode", '"client"'), ("scouting/delay", "1"))
    assert parse_address("zenoh:tcp/a:1", environ) == parse_address("zenoh:tcp/a:1", {})


@pytest.mark.parametrize(
    ("url", "problem"),
    [
        ("zenoh:host:7447", "is not an endpoint of Zenoh; write tcp/host:7447"),
        ("zenoh:tcp/host", "is not an endpoint"),
        ("zenoh:tcp/host:99999", "is not an endpoint"),
        ("zenoh?colour=red", "'colour' is not an option of a zenoh graph; known are ca, "),
        ("zenoh?domain=x", "domain is"),
        ("zenoh?domain=233", "expected a number from 0 to 232"),
        ("zenoh?mode=router", "the mode 'router' is not known; write peer or client"),
    ],
)
def test_refused(url: str, problem: str) -> None:
    """An address that cannot be used is refused with what was expected."""
    with pytest.raises(ValueError, match=problem):
        parse_address(url, {})


def test_bad_environment() -> None:
    """A variable of the environment that cannot be read is named."""
    with pytest.raises(ValueError, match="ROS_DOMAIN_ID"):
        parse_address("zenoh", {"ROS_DOMAIN_ID": "many"})
    with pytest.raises(ValueError, match="ZENOH_CONFIG_OVERRIDE has 'mode'"):
        parse_address("zenoh", {"ZENOH_CONFIG_OVERRIDE": "mode"})
