"""Says how a running gateway is seen and changed: ``gateway.control``."""

from __future__ import annotations

import re
from collections.abc import Mapping
from typing import Annotated, Final
from urllib.parse import urlsplit

from pydantic import AfterValidator, BeforeValidator, Field, WithJsonSchema

from ropeway.gateway.config.fields import Many, Model
from ropeway.gateway.config.suggest import show

__all__ = ["ControlConfig", "ControlItem", "parse_control"]

_NAME: Final = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.-]{0,63}")


def parse_control(text: str) -> str:
    """Check the address of a control API over TCP. Raises ``ValueError`` with what was expected."""
    try:
        parts = urlsplit(text)
        host, port = parts.hostname, parts.port
    except ValueError:
        host, port, parts = None, None, urlsplit("")
    if parts.scheme not in ("http", "https") or not host or port is None or parts.path not in ("", "/") or parts.query:
        raise ValueError(f"expected http://host:port or https://host:port, got {show(text)}")
    return f"{parts.scheme}://{parts.netloc.lower()}"


def _name(value: str) -> str:
    if not _NAME.fullmatch(value):
        raise ValueError(f"expected up to 64 letters, digits, _ . or -, got {show(value)}")
    return value


def _written_out(value: object) -> object:
    if isinstance(value, bool):
        return {"enabled": value}
    if isinstance(value, Mapping | ControlConfig):
        return value
    raise ValueError(f'expected true, false or an object such as {{"name": "robot1"}}, got {show(value)}')


class ControlConfig(Model):
    """The control API of the gateway."""

    enabled: bool = Field(True, description="false: nobody can see or change the gateway while it runs")
    name: Annotated[str, AfterValidator(_name)] | None = Field(
        None, description="the name by which ropeway status and others find it; default: gateway.name"
    )
    listen: Many[Annotated[str, AfterValidator(parse_control)]] = Field(
        (),
        description="http://host:port or https://host:port, beside the UNIX socket; needs gateway.auth, and roles with "
        "rights under control",
    )
    metrics: Many[Annotated[str, AfterValidator(parse_control)]] = Field(
        (),
        description="http://host:port or https://host:port that has /metrics alone, for Prometheus; needs "
        "gateway.auth, and a role with the right observe under control",
    )
    remember: bool = Field(
        True, description="false: what is changed at run time is not restored at the next start, and has no history"
    )
    journal: str | None = Field(
        None, min_length=1, description="the file that remembers; default: one in the user's state directory"
    )


ControlItem = Annotated[
    ControlConfig,
    BeforeValidator(_written_out),
    WithJsonSchema({"anyOf": [{"type": "boolean"}, {"$ref": "#/$defs/ControlConfig"}]}),
]
"""The control API, of which a truth value alone may be written."""
