"""Models the overlay's part of a configuration."""

from __future__ import annotations

import re
from typing import Annotated, Final, Literal

from pydantic import AfterValidator, Field

from ropeway.gateway.config.fields import ExistingPath, Many, Model
from ropeway.gateway.config.suggest import show
from ropeway.limits import OVERLAY_METADATA_CHARACTERS

__all__ = ["METADATA", "METADATUM", "OVERLAY", "AutomaticConfig", "Metadatum", "OverlayConfig"]

OVERLAY: Final = "overlay"
"""The address of everybody in the overlay."""

METADATA: Final = ("author", "maintainer", "description", "unique", "node")
"""The metadata of an item that goes into its global name besides its name and type."""

METADATUM: Final = "overlay: goes into the global name; default: that of gateway.overlay, or of the remote"
"""The description of each of them."""

_ENDPOINT: Final = re.compile(r"(tls|quic)/(\[[0-9a-fA-F:]+\]|[A-Za-z0-9._-]+):\d{1,5}")

_INTERFACE: Final = re.compile(r"[A-Za-z0-9._-]{1,15}")


def _endpoint(value: str) -> str:
    if not _ENDPOINT.fullmatch(value):
        raise ValueError(f"expected a Zenoh endpoint such as tls/router.example:7447 (or quic/…), got {show(value)}")
    return value


def _interface(value: str) -> str:
    if not _INTERFACE.fullmatch(value):
        raise ValueError(f"expected the name of a network interface such as wlan0, got {show(value)}")
    return value


def _pattern(value: str) -> str:
    if not value.startswith(("/", "*")):
        raise ValueError(f"expected a pattern of absolute names such as /camera/*, got {show(value)}")
    return value


Interface = Annotated[str, AfterValidator(_interface)]
Endpoint = Annotated[str, AfterValidator(_endpoint)]
Metadatum = Annotated[str | None, Field(max_length=OVERLAY_METADATA_CHARACTERS)]
Pattern = Annotated[str, AfterValidator(_pattern)]


class OverlayConfig(Model):
    """Membership of the overlay."""

    identity: ExistingPath = Field(description="its bundle, as ropeway keys issue writes it")
    routers: Many[Endpoint] | None = Field(None, description="where to connect; default: the routers of the bundle")
    listen: Many[Endpoint] = Field(
        ("tls/0.0.0.0:0",),
        description="where other members may link directly, with certificates both ways; [] for nowhere",
    )
    interfaces: Many[Interface] = Field(
        (),
        description="network interfaces (wlan0, wwan0) to dial routers by, the best first; the next one is used once a "
        "link is lost, unless links says that they are used at once",
    )
    links: Literal["best", "duplicate"] | None = Field(
        None,
        description="of several interfaces, all linked at once: best, the one that is quick and steady; duplicate: "
        "data by all, and the first copy counts",
    )
    authenticity: Literal["signed", "session"] = Field(
        "signed",
        description="how members prove that messages are theirs: signed, by a signature that anybody can check; "
        "session, to each reader alone, for less processor time, where publisher and readers all say so",
    )
    author: str = Field("", description="metadata that goes into every global name: all who share a name agree on it")
    maintainer: str = Field("", description="likewise")
    description: str = Field("", description="likewise")
    node: str = Field("", description="likewise: the name of the node that has them; default: it goes into no name")


class AutomaticConfig(Model):
    """Topics that are offered or fetched as the local graph needs (FogROS2-SGC thesis, 3.6)."""

    allow: Many[Pattern] = Field(
        (), description="patterns of topic names that may be shared; without any, nothing is shared"
    )
    deny: Many[Pattern] = Field((), description="patterns of topic names that are not shared, even if allowed")
