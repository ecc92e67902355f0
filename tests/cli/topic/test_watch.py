"""Reading a topic: types, meters, echo, and publishing, on a network inside this process."""

from __future__ import annotations

import asyncio
import json
from typing import Any

import pytest
import typer

from ropeway.cli.session import OpenGraph
from ropeway.cli.topic.delay import gauge
from ropeway.cli.topic.echo import echo, formatter
from ropeway.cli.topic.pub import publish
from ropeway.cli.topic.render import Style
from ropeway.cli.topic.watch import meter, resolve_type
from ropeway.cli.topic.window import Rate
from ropeway.errors import ValueMismatch
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.qos import SENSOR_DATA
from tests.support.clock import Stopwatch
from tests.support.messages import STRING
from tests.support.until import until

pytestmark = pytest.mark.jumping

POINT = "geometry_msgs/msg/PointStamped"


async def test_types_are_discovered(pair: tuple[OpenGraph, OpenGraph], capsys: pytest.CaptureFixture[str]) -> None:
    """The type comes from the network unless it is given; where it is neither, a sentence says what to do."""
    here, there = pair
    await there.graph.create_publisher("/a", STRING)
    assert await resolve_type(here, "/a", "", 1.0) == STRING
    assert await resolve_type(here, "/b", "std_msgs/Int8", 0.0) == "std_msgs/msg/Int8"
    with pytest.raises(typer.Exit):
        await resolve_type(here, "/b", "", 0.05)
    said = capsys.readouterr().err
    assert "WARNING: topic [/b] does not appear to be published yet" in said
    await there.graph.create_publisher("/a", "std_msgs/msg/Int8")
    with pytest.raises(typer.Exit):
        await resolve_type(here, "/a", "", 1.0)
    assert "has several types" in capsys.readouterr().err


async def test_meter_prints_each_period(pair: tuple[OpenGraph, OpenGraph], capsys: pytest.CaptureFixture[str]) -> None:
    """A meter prints while messages come, and says so when they stop."""
    here, there = pair
    publisher = await there.graph.create_publisher("/a", STRING)
    gauge = Rate()
    running = asyncio.create_task(meter(here, "/a", STRING, None, gauge, silence="no new messages", period_s=0.05))
    await until(lambda: bool(publisher.subscribers))
    for number in range(3):
        publisher.publish(Sample(b"", STRING, number * 10**9, b"", SEQ_NONE))
    said = ""
    while "no new messages" not in said:
        await asyncio.sleep(0.02)
        said += capsys.readouterr().out
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert said.startswith("average rate: ")
    assert publisher.subscribers == 0


async def test_meter_as_json(pair: tuple[OpenGraph, OpenGraph], capsys: pytest.CaptureFixture[str]) -> None:
    """With ``--json`` each line is one object with the topic."""
    here, there = pair
    publisher = await there.graph.create_publisher("/a", STRING)
    running = asyncio.create_task(meter(here, "/a", STRING, None, Rate(), as_json=True, period_s=0.05))
    await until(lambda: bool(publisher.subscribers))
    for number in range(3):
        publisher.publish(Sample(b"", STRING, 10**18 + number * 10**9, b"\1" * 16, number + 1))
    said = ""
    while "\n" not in said:
        await asyncio.sleep(0.02)
        said += capsys.readouterr().out
    running.cancel()
    with pytest.raises(asyncio.CancelledError):
        await running
    assert json.loads(said.splitlines()[0])["topic"] == "/a"
    assert json.loads(said.splitlines()[0])["rate_hz"] == pytest.approx(1.0)


async def test_delay_needs_a_header(pair: tuple[OpenGraph, OpenGraph], capsys: pytest.CaptureFixture[str]) -> None:
    """A type without header has no delay, and the command says so."""
    assert gauge(pair[0], POINT, 10).read() is None
    with pytest.raises(typer.Exit):
        gauge(pair[0], STRING, 10)
    assert "std_msgs/msg/String does not begin with a header" in capsys.readouterr().err


async def echoed(pair: tuple[OpenGraph, OpenGraph], type: str, values: dict[str, Any], **options: Any) -> str:
    """What ``echo`` prints for one message."""
    here, there = pair
    lines: list[str] = []
    form = formatter(here.registry, type, style=options.pop("style", Style()), **options)
    running = asyncio.create_task(echo(here, "/a", type, None, form, count=1, emit=lines.append))
    assert await publish(there, "/a", type, values, times=1, wait=1, keep_alive_s=0) == 1
    assert await running == 1
    return lines[0]


async def test_echo_forms(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """A message is printed as YAML, CSV, JSON or bytes, as a whole or in part."""
    values = {"header": {"stamp": {"sec": 5}, "frame_id": "map"}, "point": {"x": 1.0}}
    assert await echoed(pair, POINT, values, field="point") == "x: 1.0\ny: 0.0\nz: 0.0\n---"
    assert await echoed(pair, POINT, values, field="point.x") == "1.0\n---"
    assert (await echoed(pair, POINT, values, form="csv")).startswith("5,0,map,1.0")
    assert (await echoed(pair, STRING, {"data": "hi"}, form="raw")) == (
        f"{bytes.fromhex('00010000 03000000 686900')!r}\n---"
    )
    told = json.loads(await echoed(pair, POINT, values, form="json"))
    assert told["type"] == POINT
    assert told["msg"]["point"] == {"x": 1.0, "y": 0.0, "z": 0.0}
    assert json.loads(await echoed(pair, POINT, values, form="json", field="header.frame_id"))["msg"] == "map"


async def test_echo_of_an_array_field(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """An array is printed on one line."""
    type = "sensor_msgs/msg/LaserScan"
    assert await echoed(pair, type, {"ranges": [1.0, 2.0]}, field="ranges") == "[1.0, 2.0]\n---"


async def test_echo_skips_what_is_not_of_the_type(
    pair: tuple[OpenGraph, OpenGraph], capsys: pytest.CaptureFixture[str]
) -> None:
    """A damaged message costs a sentence, and the next is printed."""
    here, there = pair
    publisher = await there.graph.create_publisher("/a", STRING)
    lines: list[str] = []
    form = formatter(here.registry, STRING, style=Style())
    running = asyncio.create_task(echo(here, "/a", STRING, None, form, count=1, emit=lines.append))
    await until(lambda: bool(publisher.subscribers))
    publisher.publish(Sample(b"\0\1\0\0\xff\xff\xff\xff", STRING, 1, b"", SEQ_NONE))
    publisher.publish(Sample(here.registry.codec(STRING).encode({"data": "ok"}), STRING, 2, b"", SEQ_NONE))
    assert await running == 1
    assert lines == ["data: ok\n---"]
    assert "A message was not printed: CDR bytes are not a std_msgs/msg/String" in capsys.readouterr().err


async def test_echo_of_an_unknown_field_ends(
    pair: tuple[OpenGraph, OpenGraph], capsys: pytest.CaptureFixture[str]
) -> None:
    """A field that is not there ends the command with the fields there are."""
    with pytest.raises(typer.Exit):
        await echoed(pair, STRING, {"data": "x"}, field="dta")
    assert "its fields are: data" in capsys.readouterr().err


async def test_publish_paces_evenly(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """Ten messages at 100 Hz take 90 ms and not less, numbered from one."""
    here, there = pair
    watch = Stopwatch()
    came: list[float] = []
    await here.graph.create_subscription(
        "/a", STRING, SENSOR_DATA, lambda batch: came.extend(watch.seconds for _ in batch)
    )
    numbers: list[int] = []
    sent = await publish(
        there,
        "/a",
        STRING,
        {"data": "x"},
        rate_hz=100,
        times=10,
        keep_alive_s=0.05,
        told=lambda number, _: numbers.append(number),
    )
    assert sent == 10
    assert numbers == list(range(1, 11))
    assert came == pytest.approx([n / 100 for n in range(10)])


async def test_publish_refuses_values_before_anything_is_sent(pair: tuple[OpenGraph, OpenGraph]) -> None:
    """Values that do not fit are an error that names the field, and no topic appears."""
    here, there = pair
    with pytest.raises(ValueMismatch, match="dta"):
        await publish(there, "/a", STRING, {"dta": "x"}, times=1)
    assert here.graph.topics() == {}


async def test_publish_waits_for_subscribers(
    pair: tuple[OpenGraph, OpenGraph], capsys: pytest.CaptureFixture[str]
) -> None:
    """With a time limit, missing subscribers end the command."""
    with pytest.raises(typer.Exit):
        await publish(pair[1], "/a", STRING, {}, times=1, wait=1, wait_s=0.05)
    said = capsys.readouterr().err
    assert "Waiting for at least 1 matching subscription(s)..." in said
    assert "Timed out waiting for subscribers of /a: expected 1, there are 0" in said
