"""What waits for a viewer, and in which order it goes."""

from __future__ import annotations

from ropeway.delivery.outbox import Lost
from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.networks.foxglove.settings import FoxgloveSettings
from ropeway.qos import QoS
from tests.networks.foxglove.viewer import Sight, Viewer
from tests.support.messages import STRING, joined, sample, text
from tests.support.until import until

IMAGE = "sensor_msgs/msg/Image"
LARGE = 1 << 20


def image() -> Sample:
    """Return a message that a link takes alone."""
    return Sample(bytes(LARGE), IMAGE, 0, bytes(16), SEQ_NONE)


async def stall(sight: Sight, viewer: Viewer) -> None:
    """Publish images until the link of a viewer that takes no frames is full."""
    camera = await sight.robot.create_publisher("/camera", IMAGE, QoS(depth=5))
    await viewer.subscribe("/camera", 1)
    await joined(camera)
    sent = 0
    while sight.session.connection.flow.free:
        camera.publish(image())
        sent += 1
        await until(lambda sent=sent: _row(sight, "/camera")["messages"] == sent)


def _row(sight: Sight, topic: str) -> dict[str, int]:
    """Return the row of a topic that the viewer reads."""
    return next(row for row in sight.session.status()["topics"] if row["name"] == topic)


async def test_the_freshest(sight: Sight) -> None:
    """While a link takes nothing the newest messages wait and those they replace are counted; then they go in order."""
    small = await sight.robot.create_publisher("/small", STRING, QoS(depth=3))
    viewer = await sight.viewer(receive_bytes=1024)
    await viewer.subscribe("/small", 2)
    await joined(small)
    await stall(sight, viewer)
    for number in range(10):
        small.publish(sample(str(number)))
    await until(lambda: _row(sight, "/small")["messages"] == 10)
    assert sum(sight.session.status()["topics"][0]["drops"].values()) == 7
    await viewer.until(lambda: sum(message.subscription == 2 for message in viewer.messages) == 3)
    got = [message.payload for message in viewer.messages if message.subscription == 2]
    assert got == [text(str(number)) for number in (7, 8, 9)]


async def test_the_limit(dark: Sight) -> None:
    """No more bytes of messages wait for a viewer than its buffer has, and what finds no room is counted."""
    await dark.start(FoxgloveSettings(send_buffer_bytes=2 * LARGE))
    cameras = [await dark.robot.create_publisher(f"/camera{number}", IMAGE, QoS(depth=1)) for number in range(6)]
    viewer = await dark.viewer(receive_bytes=1024)
    for number, camera in enumerate(cameras, 2):
        await viewer.subscribe(camera.topic, number)
        await joined(camera)
    await stall(dark, viewer)
    for camera in cameras:
        camera.publish(image())
    sender = dark.session.sender
    await until(lambda: sum(_row(dark, camera.topic)["messages"] for camera in cameras) == len(cameras))
    assert sender.outbox.bytes <= 2 * LARGE
    lost = [reader._queue.lost[Lost.OVERFLOW] for reader in dark.session._readers.values()]
    assert sum(lost) >= len(cameras) - 2


async def test_answers_in_order(sight: Sight) -> None:
    """Answers wait behind those before them, whatever messages wait, and none is lost."""
    viewer = await sight.viewer(receive_bytes=1024)
    await stall(sight, viewer)
    sender = sight.session.sender
    for number in range(20):
        sender.text(b'{"op":"test","number":%d}' % number)
    assert (sender.count, sender.idle) == (20, False)
    assert [(await viewer.op("test"))["number"] for _ in range(20)] == list(range(20))
    await until(lambda: sender.idle)
    assert (sender.count, sender.answers_bytes) == (0, 0)


async def test_time_that_waits(sight: Sight) -> None:
    """Of the times that a viewer could not be told, it gets the last."""
    viewer = await sight.viewer(receive_bytes=1024)
    await stall(sight, viewer)
    for now_ns in (5, 6, 7):
        sight.session.sender.tell_time(now_ns)
    await viewer.until(lambda: viewer.binary)
    await viewer.passed()
    assert viewer.binary == [b"\x02\x07\0\0\0\0\0\0\0"]


async def test_closed(sight: Sight) -> None:
    """When a viewer is gone, nothing waits for it any more."""
    viewer = await sight.viewer(receive_bytes=1024)
    await stall(sight, viewer)
    session = sight.session
    session.sender.text(b"{}")
    viewer.abort()
    await until(lambda: not sight.server.sessions)
    assert (session.sender.outbox.bytes, session.sender.answers_bytes, session.sender.idle) == (0, 0, True)
