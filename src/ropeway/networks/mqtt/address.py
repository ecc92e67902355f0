"""Reads the address of an ``mqtt`` graph: ``mqtt://host``, ``mqtts://host:8883?user=robot&password_file=PATH``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final
from urllib.parse import parse_qsl, urlsplit

from ropeway.errors import InvalidName
from ropeway.networks.mqtt.names import check_filter, check_topic, is_pattern

__all__ = ["KEYS", "PORTS", "MqttAddress", "parse_address", "read_password"]

PORTS: Final[Mapping[str, int]] = {"mqtt": 1883, "mqtts": 8883}
"""The schemes of an address, and the port where it names none."""

KEYS: Final = ("announce", "client_id", "discover", "keep_alive_s", "password_env", "password_file", "user", "version")
"""The keys that may stand behind the ``?`` of an address."""

VERSIONS: Final = ("5", "3.1.1")
_KEEP_ALIVE_S: Final = (2, 65_535)
_CLIENT_ID: Final = re.compile(r"[A-Za-z0-9_.:-]{1,65}")
_PASSWORD_BYTES: Final = 65_535


@dataclass(frozen=True, slots=True)
class MqttAddress:
    """A broker and how it is spoken to.

    ``discover`` are the filters of the topics that are looked at to list them, ``None`` where the address does not say
    it. ``announce`` is the topic below which gateways tell each other what they publish and read, ``""`` for nowhere.
    ``password_file`` and ``password_env`` say where the password of ``user`` is.
    """

    host: str
    port: int
    tls: bool = False
    user: str = ""
    password_file: str = ""
    password_env: str = ""
    client_id: str = ""
    discover: tuple[str, ...] | None = None
    announce: str = "ropeway"
    keep_alive_s: int = 5
    version: str = "5"

    @property
    def url(self) -> str:
        """The address without its options."""
        host = f"[{self.host}]" if ":" in self.host else self.host
        return f"{'mqtts' if self.tls else 'mqtt'}://{host}:{self.port}"


def parse_address(url: str) -> MqttAddress:
    """Parse the address of a graph. Raises ``ValueError`` with what was expected, and never with a password."""
    try:
        parts = urlsplit(url)
        port = parts.port
    except ValueError as error:
        raise ValueError(f"expected mqtt://host:port or mqtts://host:port ({error})") from None
    if parts.username is not None or parts.password is not None:
        raise ValueError("an address holds no password; write mqtt://host?user=NAME&password_file=PATH")
    if parts.scheme not in PORTS or not parts.hostname or parts.path not in ("", "/") or parts.fragment:
        raise ValueError("expected mqtt://host:port or mqtts://host:port, without a path")
    given = dict(parse_qsl(parts.query, keep_blank_values=True))
    if unknown := [key for key in given if key not in KEYS]:
        raise ValueError(f"{unknown[0][:40]!r} is not an option of an mqtt graph; known are {', '.join(KEYS)}")
    made = MqttAddress(
        parts.hostname,
        PORTS[parts.scheme] if port is None else port,
        parts.scheme == "mqtts",
        **{key: given[key] for key in ("user", "password_file", "password_env") if key in given},
        client_id=_client_id(given.get("client_id", "")),
        discover=_filters(given["discover"]) if "discover" in given else None,
        announce=_prefix(given.get("announce", "ropeway")),
        keep_alive_s=_seconds(given.get("keep_alive_s", "5")),
        version=_version(given.get("version", "5")),
    )
    if not made.port:
        raise ValueError("expected a port from 1 to 65535")
    if (made.password_file or made.password_env) and not made.user:
        raise ValueError("a password is that of a user; name it with user=")
    return made


def read_password(address: MqttAddress, environ: Mapping[str, str]) -> str | None:
    """Return the password of the user, ``None`` where none is named. Raises ``ValueError`` where it cannot be read."""
    if address.password_env:
        password = environ.get(address.password_env)
        if password is None:
            raise ValueError(f"the environment variable {address.password_env} is not set")
    elif address.password_file:
        try:
            with Path(address.password_file).open(encoding="utf-8") as file:
                password = file.read(_PASSWORD_BYTES).strip("\r\n")
        except OSError as error:
            raise ValueError(f"{address.password_file} cannot be read: {error.strerror}") from None
        except UnicodeDecodeError:
            raise ValueError(f"{address.password_file} holds no password: it is not UTF-8 text") from None
    else:
        return None
    return password


def _client_id(text: str) -> str:
    if text and not _CLIENT_ID.fullmatch(text):
        raise ValueError("client_id: expected up to 65 letters, digits and _.:-")
    return text


def _filters(text: str) -> tuple[str, ...]:
    return tuple(check_filter(part) for part in text.split(",") if part)


def _prefix(text: str) -> str:
    if text in ("", "no"):
        return ""
    try:
        if is_pattern(check_topic(text)) or text.startswith(("/", "$")) or text.endswith("/"):
            raise ValueError
    except (InvalidName, ValueError):
        raise ValueError("announce: expected a topic such as ropeway, or no") from None
    return text


def _seconds(text: str) -> int:
    low, high = _KEEP_ALIVE_S
    if not (text.isascii() and text.isdigit() and len(text) < 6) or not low <= int(text) <= high:
        raise ValueError(f"keep_alive_s: expected whole seconds from {low} to {high}")
    return int(text)


def _version(text: str) -> str:
    if text not in VERSIONS:
        raise ValueError(f"version: expected {' or '.join(VERSIONS)}")
    return text
