"""Models what Foxglove viewers are shown; the keys are named as the parameters of foxglove_bridge."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Annotated

from pydantic import AfterValidator, Field

from ropeway.gateway.config.fields import ExistingPath, Many, Model
from ropeway.gateway.config.suggest import one_of, show
from ropeway.networks.foxglove.settings import ASSET_PATTERN, CAPABILITIES, FoxgloveSettings, patterns

__all__ = ["FoxgloveConfig"]


def _expression(text: str) -> str:
    try:
        re.compile(text)
    except re.error as error:
        raise ValueError(f"expected a regular expression, got {show(text)} ({error})") from None
    return text


def _capability(text: str) -> str:
    if text not in CAPABILITIES:
        raise ValueError(one_of(text, CAPABILITIES))
    return text


Expressions = Many[Annotated[str, AfterValidator(_expression)]]


class FoxgloveConfig(Model):
    """Says what viewers are shown, and what they may do beside their roles."""

    enabled: bool = Field(True, description="viewers are served on the ws:// and wss:// listeners, too")
    topic_whitelist: Expressions = Field((".*",), description="topics that are shown; each matches a whole name")
    service_whitelist: Expressions = Field((".*",), description="services that are shown")
    param_whitelist: Expressions = Field((".*",), description="parameters that are shown, as /node.parameter")
    client_topic_whitelist: Expressions = Field((".*",), description="topics that viewers may publish")
    best_effort_qos_topic_whitelist: Expressions = Field(
        (), description="topics that are read as best effort, whatever their publishers offer"
    )
    min_qos_depth: int = Field(1, ge=0, description="how many messages of a topic wait for a viewer at least")
    max_qos_depth: int = Field(25, ge=1, description="how many wait at most; of big ones only the newest does")
    send_buffer_limit: int = Field(10_000_000, ge=0, description="bytes of messages that wait for one viewer")
    use_sim_time: bool = Field(False, description="viewers are told the time of /clock")
    capabilities: Many[Annotated[str, AfterValidator(_capability)]] = Field(
        CAPABILITIES, description="the parts of the protocol that viewers may use"
    )
    include_hidden: bool = Field(False, description="topics and services with a part that begins with _ are shown")
    asset_roots: Many[ExistingPath] = Field(
        (),
        description="directories with packages, whose files viewers may fetch (package://NAME/PATH)",
    )
    asset_uri_allowlist: Expressions = Field((ASSET_PATTERN,), description="files that viewers may fetch from there")

    def settings(self) -> FoxgloveSettings:
        """Return what a server makes of it."""
        return FoxgloveSettings(
            topics=patterns(self.topic_whitelist),
            services=patterns(self.service_whitelist),
            params=patterns(self.param_whitelist),
            client_topics=patterns(self.client_topic_whitelist),
            best_effort=patterns(self.best_effort_qos_topic_whitelist),
            min_depth=self.min_qos_depth,
            max_depth=self.max_qos_depth,
            send_buffer_bytes=self.send_buffer_limit,
            sim_time=self.use_sim_time,
            capabilities=frozenset(self.capabilities),
            include_hidden=self.include_hidden,
            asset_roots=tuple(map(Path, self.asset_roots)),
            asset_uris=patterns(self.asset_uri_allowlist),
        )
