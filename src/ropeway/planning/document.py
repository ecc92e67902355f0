"""Reads a plan from a document: links, and topics with the hosts that publish and read them."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

from pydantic import Field, ValidationError

from ropeway.errors import ConfigError
from ropeway.gateway.config.expected_model import ExpectedLink
from ropeway.gateway.config.fields import Many, Model
from ropeway.gateway.config.route_fields import Encoding, Name, Seconds
from ropeway.gateway.config.shape import shape_problems
from ropeway.planning.plan import MBIT_BPS, PlannedLink, PlannedTopic, TrafficPlan

__all__ = ["PlanDocument", "is_plan", "parse_plan"]

Host = Annotated[str, Field(min_length=1)]
Endpoints = dict[Host, Annotated[int, Field(ge=1, le=10_000)]]


class LinkItem(ExpectedLink):
    """A link of a plan."""

    between: Many[Host] = Field((), description="the hosts that it joins; left out: all hosts share it")


class PlannedTopicItem(Model):
    """A topic of a plan."""

    name: Name = Field(description="its name")
    type: str = Field("", description="its type; for people")
    bytes: float = Field(gt=0, allow_inf_nan=False, description="mean size of a message")
    hz: Seconds = Field(description="messages per second of each publisher")
    publishers: Endpoints = Field(description='how many publishers on which host, such as {"robot": 1}')
    readers: Endpoints = Field(description='how many readers on which host, such as {"cloud": 3}')
    encoding: Encoding = Field("auto", description="how gateways send it")
    ratios: dict[str, Annotated[float, Field(gt=0, allow_inf_nan=False)]] = Field(
        default_factory=dict, description='compression ratio by encoding, such as {"zip": 2.1}; default: 1'
    )


class PlanDocument(Model):
    """A plan as a file."""

    links: Annotated[Many[LinkItem], Field(min_length=1)] = Field(description="the links between hosts")
    topics: Annotated[Many[PlannedTopicItem], Field(min_length=1)] = Field(description="the topics that cross")

    def plan(self) -> TrafficPlan:
        """Return the plan."""
        links = (
            PlannedLink(MBIT_BPS * link.mbit, link.delay_ms / 1e3, frozenset(link.between), link.duplex)
            for link in self.links
        )
        topics = (
            PlannedTopic(
                topic.name,
                topic.bytes,
                topic.hz,
                topic.publishers,
                topic.readers,
                topic.type,
                topic.encoding,
                topic.ratios,
            )
            for topic in self.topics
        )
        return TrafficPlan(tuple(topics), tuple(links))


def is_plan(value: object) -> bool:
    """Return whether a document is meant as a plan, not as the configuration of a gateway."""
    return isinstance(value, dict) and bool(value.keys() & {"links", "topics"})


def parse_plan(value: Any, source: str | Path = "") -> TrafficPlan:
    """Make a plan of a parsed document. Raises ``ConfigError`` with every fault, each with its path."""
    try:
        document = PlanDocument.model_validate(value)
    except ValidationError as error:
        raise ConfigError(shape_problems(error, PlanDocument), str(source)) from error
    problems = [
        (f"topics[{number}]", f"no link joins {here} and {there}")
        for number, topic in enumerate(document.plan().topics)
        for here, there in TrafficPlan((topic,), ()).ways()
        if not any(link.carries((here, there)) for link in document.plan().links)
    ]
    if problems:
        raise ConfigError(problems, str(source))
    return document.plan()
