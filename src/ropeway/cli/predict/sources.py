"""Gathers what a prediction is made of: options, a configuration or a plan, a recording, a network that runs."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Final

from ropeway.cli.console import complain, fail
from ropeway.cli.loop import run
from ropeway.cli.session import OpenGraph, full_name, open_session, settle
from ropeway.errors import TypesError
from ropeway.extras import require
from ropeway.gateway.config.config import Config, parse
from ropeway.gateway.config.document import read_file
from ropeway.gateway.config.fleet import GatewayFleet, is_fleet, read_fleet, select
from ropeway.gateway.config.suggest import did_you_mean, one_of
from ropeway.graph.base import Sample
from ropeway.planning.configured import plan_of, plan_of_fleet
from ropeway.planning.document import is_plan, parse_plan
from ropeway.planning.measured import TopicSampler
from ropeway.planning.plan import PlannedLink, PlannedTopic, TrafficPlan
from ropeway.planning.prediction import encodings_of
from ropeway.types import TypeRegistry

__all__ = ["PredictionInput", "chosen_encodings", "gather", "measure_topics", "parse_topic"]

_KEYS: Final = ("bytes", "hz", "from", "to", "ratio")
_SPIN_S: Final = 2.0  # for discovery


@dataclass(frozen=True)
class PredictionInput:
    """Options of the verb: a file, topics, and the link between two hosts."""

    file: Path | None
    topics: list[str]
    hosts: str
    mbit: float
    delay_s: float
    duplex: bool
    readers: int
    part: str = ""

    def ends(self) -> tuple[str, str]:
        """Return the host that sends and the one that receives, or exit with a sentence."""
        names = [name.strip() for name in self.hosts.split(",")]
        if len(names) != 2 or not all(names) or names[0] == names[1]:
            fail(f'--hosts takes two names, such as robot,cloud, not "{self.hosts}"', 2)
        return names[0], names[1]

    def link(self) -> PlannedLink | None:
        """Return the link that the options describe; ``None`` without ``--mbit``."""
        return PlannedLink(1e6 * self.mbit, self.delay_s, frozenset(self.ends()), self.duplex) if self.mbit else None


def chosen_encodings(wanted: Sequence[str], plan: TrafficPlan) -> list[str]:
    """Return the encodings to predict, all that are known unless some are named; exit for one that is not known."""
    known = encodings_of(plan)
    for name in wanted:
        if name not in known:
            fail(
                f"--encoding: {one_of(name, known)}; the compression ratio has to be known for every topic: measure it "
                "with --bag or --graph, or give it",
                2,
            )
    return list(wanted or known)


def gather(
    told: PredictionInput, *, bag: Path | None, graph: str, seconds: float, types: list[Path] | None
) -> tuple[TrafficPlan, list[str]]:
    """Return the plan, and what is left out of it; measure first where that is asked for."""
    document = read_file(told.file) if told.file is not None else None
    if is_plan(document):
        return parse_plan(document, told.file or ""), []
    configured = _configured(document, told)
    given = [parse_topic(text, told) for text in told.topics]
    names = [topic.name for topic in given] or _names(configured)
    measured: dict[str, PlannedTopic] = {}
    if bag is not None:
        measured = _measure_bag(bag, names, seconds, told, types)
    elif graph:
        measured = run(_measure_graph(graph, names, seconds, told, types))
    if isinstance(configured, GatewayFleet):
        return plan_of_fleet(configured, measured, told.link())
    if configured is not None:
        return plan_of(configured, measured, told.link())
    link = told.link()
    if link is None:
        fail("say what the link carries with --mbit", 2)
    return _plan_of_topics(given, measured, link)


def _configured(document: Any, told: PredictionInput) -> Config | GatewayFleet | None:
    """Return what the file describes: a gateway, or all of a document where none is chosen."""
    if told.file is None:
        return None
    directory = told.file.parent
    if is_fleet(document) and not told.part:
        return read_fleet(document, str(told.file), directory=directory)
    return parse(select(document, told.part), str(told.file), directory=directory, part=told.part)


def _names(configured: Config | GatewayFleet | None) -> list[str]:
    if configured is None:
        return []
    configs = configured.members.values() if isinstance(configured, GatewayFleet) else (configured,)
    return [route.name for config in configs for route in config.routes()]


def parse_topic(text: str, told: PredictionInput) -> PlannedTopic:
    """Return the topic that ``NAME,bytes=N,hz=N,...`` describes, without figures 0; exit with a sentence otherwise."""
    name, *pairs = (part.strip() for part in text.split(","))
    here, there = told.ends()
    values = dict(pair.partition("=")[::2] for pair in pairs)
    for key in values:
        if key not in _KEYS:
            fail(f"--topic {text}: {key} is not known, use {', '.join(_KEYS)}{did_you_mean(key, _KEYS)}", 2)
    source = values.get("from", here)
    sink, _, count = values.get("to", there if source != there else here).partition(":")
    ratio = _number(text, "ratio", values.get("ratio", "0"))
    return PlannedTopic(
        name=full_name(name),
        size_bytes=_number(text, "bytes", values.get("bytes", "0")),
        published_hz=_number(text, "hz", values.get("hz", "0")),
        publishers={source: 1},
        readers={sink: int(_number(text, "to", count)) if count else told.readers},
        ratios={"zip": ratio} if ratio else {},
    )


def _number(text: str, key: str, value: str) -> float:
    try:
        number = float(value)
    except ValueError:
        number = -1.0
    if not 0 <= number < 1e15:
        fail(f"--topic {text}: {key} takes a number, not {value!r}", 2)
    return number


def _plan_of_topics(
    given: list[PlannedTopic], measured: Mapping[str, PlannedTopic], link: PlannedLink
) -> tuple[TrafficPlan, list[str]]:
    topics: list[PlannedTopic] = []
    left_out: list[str] = []
    for topic in given:
        found = measured.get(topic.name)
        if topic.size_bytes and topic.published_hz:
            topics.append(topic)
        elif found is not None:
            topics.append(replace(found, publishers=topic.publishers, readers=topic.readers))
        else:
            left_out.append(topic.name)
    if not given:
        topics = list(measured.values())
    return TrafficPlan(tuple(topics), (link,)), left_out


def _measured(
    samplers: Iterable[TopicSampler], registry: TypeRegistry, told: PredictionInput
) -> dict[str, PlannedTopic]:
    here, there = told.ends()
    found = {}
    for sampler in samplers:
        try:
            codec = registry.codec(sampler.type)
        except TypesError as error:
            complain(f"{sampler.name}: how far it can be compressed is not known: {error}")
            codec = None
        topic = sampler.topic(codec, {here: 1}, {there: told.readers})
        if topic is not None:
            found[sampler.name] = topic
    return found


def _registry(types: list[Path] | None) -> TypeRegistry:
    registry = TypeRegistry()
    registry.add_ament_prefix_path()
    for path in types or []:
        registry.add_path(path)
    return registry


def _measure_bag(
    path: Path, names: list[str], seconds: float, told: PredictionInput, types: list[Path] | None
) -> dict[str, PlannedTopic]:
    require("bags", "ropeway predict --bag")
    from ropeway.recording.bag import Bag

    registry = _registry(types)
    samplers: dict[str, TopicSampler] = {}
    with Bag(path, registry) as recording:
        end_ns = recording.start_ns + int(seconds * 1e9)
        for record in recording.records(names):
            if record.time_ns > end_ns:
                break
            topic = record.topic
            samplers.setdefault(topic.name, TopicSampler(topic.name, topic.type)).add(record.time_ns, record.payload)
    return _measured(samplers.values(), registry, told)


async def _measure_graph(
    url: str, names: list[str], seconds: float, told: PredictionInput, types: list[Path] | None
) -> dict[str, PlannedTopic]:
    async with open_session(url, types) as session:
        complain(f"Measuring {session.graph.name} for {seconds:g} s")
        samplers = await measure_topics(session, names, lambda _: asyncio.sleep(seconds))
        return _measured(samplers.values(), session.registry, told)


async def measure_topics(
    session: OpenGraph, names: list[str], during: Callable[[Mapping[str, TopicSampler]], Awaitable[object]]
) -> dict[str, TopicSampler]:
    """Read the named topics of a graph, without names all that are published, while ``during`` runs on the samplers."""
    wanted = set(names)
    found = await settle(session.graph, _SPIN_S, (lambda topics: topics.keys() >= wanted) if wanted else None)
    samplers: dict[str, TopicSampler] = {}
    subscriptions = []
    try:
        for name, info in found.items():
            if not info.publishers or not info.type or (wanted and name not in wanted):
                continue
            sampler = samplers[name] = TopicSampler(name, info.type)
            subscriptions.append(await session.graph.create_subscription(name, info.type, None, _adding_to(sampler)))
        await during(samplers)
    finally:
        for subscription in subscriptions:
            await subscription.close()
    return samplers


def _adding_to(sampler: TopicSampler) -> Callable[[Sequence[Sample]], None]:
    def received(batch: Sequence[Sample]) -> None:
        for sample in batch:
            sampler.add(sample.stamp_ns, sample.payload)

    return received
