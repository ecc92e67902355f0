"""ropeway.networks.mqtt.address: how a broker is written."""

from __future__ import annotations

from pathlib import Path

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.networks.factory import make_graph
from ropeway.networks.mqtt.address import MqttAddress, parse_address, read_password


def test_addresses() -> None:
    """An address names a host, and may say the port and more."""
    assert parse_address("mqtt://broker") == MqttAddress("broker", 1883)
    assert parse_address("mqtts://broker") == MqttAddress("broker", 8883, True)
    full = parse_address(
        "mqtt://[::1]:1884?user=a&discover=a/%23,b/%2B&announce=no&keep_alive_s=9&version=3.1.1&client_id=x"
    )
    assert full.url == "mqtt://[::1]:1884"
    assert (full.user, full.discover, full.announce, full.keep_alive_s) == ("a", ("a/#", "b/+"), "", 9)
    assert (full.version, full.client_id) == ("3.1.1", "x")
    assert parse_address("mqtt://broker?discover=").discover == ()


@pytest.mark.parametrize(
    "query",
    [
        "keep_alive_s=1",
        "keep_alive_s=x",
        "keep_alive_s=٣",
        "version=4",
        "client_id=a b",
        "announce=a/%23",
        "announce=/a",
        "announce=$a",
        "discover=a%23",
        "password_file=x",
        "nothing=1",
    ],
)
def test_bad_options(query: str) -> None:
    """An option that cannot be is refused with what was expected."""
    with pytest.raises(ValueError, match=r"expected|not an option|stands|password"):
        parse_address(f"mqtt://broker?{query}")


@pytest.mark.parametrize(
    "url",
    [
        "mqtt://",
        "mqtt://:1883",
        "mqtt://a:0",
        "mqtt://a:99999",
        "mqtt://a/b",
        "mqtt://a#b",
        "http://a",
        "mqtt://u:hidden@a",
    ],
)
def test_bad_addresses(url: str) -> None:
    """What is no address of a broker is refused, without showing a password."""
    with pytest.raises(ValueError, match=r"expected|password") as caught:
        parse_address(url)
    assert "hidden" not in str(caught.value)


def test_password_of_a_url_is_not_shown() -> None:
    """An address with a password is refused by the factory, too, and the password is not in the error."""
    with pytest.raises(GraphUnavailable, match="password_file") as caught:
        make_graph("mqtt://user:hidden@broker")
    assert "hidden" not in str(caught.value)


def test_passwords(tmp_path: Path) -> None:
    """A password comes from a file, as its first lines are, or from the environment."""
    file = tmp_path / "password"
    file.write_text("right wörd\n")
    assert read_password(parse_address(f"mqtt://a?user=u&password_file={file}"), {}) == "right wörd"
    assert read_password(parse_address("mqtt://a?user=u&password_env=X"), {"X": "y"}) == "y"
    assert read_password(parse_address("mqtt://a"), {}) is None
    file.write_bytes(b"\xff")
    for query in (f"password_file={file}", "password_env=X", f"password_file={tmp_path / 'none'}"):
        with pytest.raises(ValueError, match=r"not set|cannot be read|not UTF-8"):
            read_password(parse_address(f"mqtt://a?user=u&{query}"), {})
