"""ropeway.delivery.outbox."""

from __future__ import annotations

import random
from dataclasses import dataclass

from ropeway.delivery.outbox import FRESH_BYTES, SMALL_BYTES, Lost, Outbox, Queue


@dataclass
class Message:
    payload: bytes
    stamp_ns: int = 0


def drain(outbox: Outbox[Message], now_ns: int = 0) -> list[bytes]:
    out = []
    while True:
        for lane in outbox.lanes():
            taken = outbox.take(lane, now_ns)
            if taken is not None:
                queue, message = taken
                out.append(message.payload)
                outbox.served(queue, len(message.payload))
                outbox.done(queue)
                break
        else:
            return out


def test_only_the_newest_image_waits() -> None:
    """Of a topic with big messages only the newest waits; those it displaced are counted."""
    outbox: Outbox[Message] = Outbox()
    camera: Queue[Message] = outbox.open(Queue("camera", depth=10))
    for i in range(5):
        outbox.put(camera, Message(bytes([i]) * 300_000))
    assert drain(outbox) == [b"\4" * 300_000]
    assert camera.lost == {Lost.REPLACED: 4}


def test_released() -> None:
    """A topic that is taken out keeps what waits in it, for another outbox to send."""
    outbox: Outbox[Message] = Outbox()
    camera, tf = outbox.open(Queue("camera")), outbox.open(Queue("tf", depth=10))
    for message in (b"1", b"2"):
        outbox.put(tf, Message(message))
    outbox.put(camera, Message(b"image"))
    assert [message.payload for message in outbox.release(tf)] == [b"1", b"2"]
    assert outbox.statistics() == (1, 5, 1)
    assert not tf.lost
    assert drain(outbox) == [b"image"]
    assert outbox.release(camera) == []


def test_latched_messages_all_wait() -> None:
    """Of a latched topic as many messages wait as its depth says, however big they are."""
    outbox: Outbox[Message] = Outbox()
    maps: Queue[Message] = outbox.open(Queue("map", depth=3))
    maps.latched = True
    for i in range(5):
        outbox.put(maps, Message(bytes([i]) * 300_000))
    assert drain(outbox) == [bytes([i]) * 300_000 for i in (2, 3, 4)]


def test_small_messages_queue_to_their_depth() -> None:
    """Small messages wait in order up to the depth of their topic; the oldest makes room."""
    outbox: Outbox[Message] = Outbox()
    tf: Queue[Message] = outbox.open(Queue("tf", depth=100))
    for i in range(120):
        outbox.put(tf, Message(bytes([i])))
    assert drain(outbox) == [bytes([i]) for i in range(20, 120)]
    assert tf.lost == {Lost.REPLACED: 20}


def test_keep_last_is_bounded_in_bytes() -> None:
    """What waits of a keep-last topic never exceeds 64 KiB, unless it is one message."""
    outbox: Outbox[Message] = Outbox()
    scans: Queue[Message] = outbox.open(Queue("scan", depth=100))
    for _ in range(100):
        outbox.put(scans, Message(b"x" * 4000))
    assert FRESH_BYTES - 4000 < outbox.bytes <= FRESH_BYTES


def test_keep_all_is_bounded_in_bytes() -> None:
    """A keep-all topic keeps everything up to its byte limit, then loses the oldest, counted as overflow."""
    outbox: Outbox[Message] = Outbox()
    logs: Queue[Message] = outbox.open(Queue("log", depth=None, limit_bytes=1000))
    for i in range(20):
        outbox.put(logs, Message(bytes([i]) * 100))
    assert [m[0] for m in drain(outbox)] == list(range(10, 20))
    assert logs.lost == {Lost.OVERFLOW: 10}


def test_priority_first() -> None:
    """A message of an urgent lane goes before all others, whenever it came."""
    outbox: Outbox[Message] = Outbox()
    image: Queue[Message] = outbox.open(Queue("image", priority=4))
    command: Queue[Message] = outbox.open(Queue("cmd_vel", priority=0))
    outbox.put(image, Message(b"image"))
    outbox.put(command, Message(b"command"))
    assert drain(outbox) == [b"command", b"image"]


def test_topics_take_turns() -> None:
    """Topics of one lane take turns, so that a busy one does not starve the others."""
    outbox: Outbox[Message] = Outbox()
    a: Queue[Message] = outbox.open(Queue("a", depth=10))
    b: Queue[Message] = outbox.open(Queue("b", depth=10))
    for i in range(3):
        outbox.put(a, Message(b"a%d" % i))
    for i in range(2):
        outbox.put(b, Message(b"b%d" % i))
    assert drain(outbox) == [b"a0", b"b0", b"a1", b"b1", b"a2"]


def test_lifespan() -> None:
    """What outlived its lifespan while it waited is not sent, and counted."""
    outbox: Outbox[Message] = Outbox()
    queue: Queue[Message] = outbox.open(Queue("t", depth=10, lifespan_ns=100))
    outbox.put(queue, Message(b"old", stamp_ns=0))
    outbox.put(queue, Message(b"new", stamp_ns=150))
    assert drain(outbox, now_ns=200) == [b"new"]
    assert queue.lost == {Lost.EXPIRED: 1}


def test_close_loses_what_waits() -> None:
    """A closed queue takes what waited with it; the counts of the outbox stay right."""
    outbox: Outbox[Message] = Outbox()
    a: Queue[Message] = outbox.open(Queue("a", depth=10))
    b: Queue[Message] = outbox.open(Queue("b", depth=10))
    outbox.put(a, Message(b"aa"))
    outbox.put(b, Message(b"b"))
    outbox.close(a)
    assert outbox.statistics() == (1, 1, 1)
    assert a.lost == {Lost.UNSENT: 1}
    assert drain(outbox) == [b"b"]
    assert outbox.statistics() == (0, 0, 0)


def test_full() -> None:
    """``full`` tells beforehand whether a message would displace another."""
    outbox: Outbox[Message] = Outbox()
    queue: Queue[Message] = outbox.open(Queue("t", depth=2))
    assert not outbox.full(queue, 10**9)
    outbox.put(queue, Message(b"x"))
    assert not outbox.full(queue, 1)
    assert outbox.full(queue, FRESH_BYTES)
    outbox.put(queue, Message(b"x"))
    assert outbox.full(queue, 1)


def test_a_replaced_message_keeps_its_turn() -> None:
    """Under overload two topics that are replaced again and again still alternate."""
    outbox: Outbox[Message] = Outbox()
    a: Queue[Message] = outbox.open(Queue("a"))
    b: Queue[Message] = outbox.open(Queue("b"))
    sent = []
    for _ in range(20):
        for queue, name in ((a, b"a"), (b, b"b"), (b, b"b"), (a, b"a")):
            outbox.put(queue, Message(name))
        taken = outbox.take(4, 0)
        assert taken is not None
        sent.append(taken[1].payload)
        outbox.served(taken[0], 1)
        outbox.done(taken[0])
    assert sent == [b"a", b"b"] * 10


def test_topics_share_by_bytes() -> None:
    """A topic with small messages gets as many bytes as one with large ones, and each by its weight."""
    outbox: Outbox[Message] = Outbox()
    images: Queue[Message] = outbox.open(Queue("images"))
    scans: Queue[Message] = outbox.open(Queue("scans", depth=None, limit_bytes=1 << 30))
    heavy: Queue[Message] = outbox.open(Queue("heavy", weight=2.0))
    sent = dict.fromkeys((images, scans, heavy), 0)
    for _ in range(1000):
        outbox.put(scans, Message(b"s" * 1000))
    for _ in range(300):
        for queue in (images, heavy):
            if not queue.waiting:
                outbox.put(queue, Message(b"i" * 30_000))
        taken = outbox.take(4, 0)
        assert taken is not None
        queue, message = taken
        sent[queue] += len(message.payload)
        outbox.served(queue, len(message.payload))
        outbox.done(queue)
    assert abs(sent[images] - sent[scans]) <= 30_000
    assert abs(sent[heavy] - 2 * sent[images]) <= 90_000


def test_a_topic_within_its_share_gets_all_it_asks_for() -> None:
    """A small message goes before the images of its lane that wait, and overtakes the one that is under way."""
    outbox: Outbox[Message] = Outbox()
    colour: Queue[Message] = outbox.open(Queue("colour"))
    depth: Queue[Message] = outbox.open(Queue("depth"))
    command: Queue[Message] = outbox.open(Queue("command", depth=10))
    parts = late = 0
    for _ in range(20):
        for queue, size in ((colour, 300_000), (depth, 200_000)):
            if not queue.waiting:
                outbox.put(queue, Message(b"i" * size))
        taken = outbox.take(4, 0)
        assert taken is not None
        image = taken[0]
        for _ in range(len(taken[1].payload) // 4000):
            outbox.put(command, Message(b"x" * 100))
            outbox.served(image, 4000)
            parts += 1
            late += not outbox.overtakes(4, image)
            while outbox.overtakes(4, image):
                found = outbox.take(4, 0, small=True)
                assert found is not None
                assert found[0] is command
                outbox.served(command, 100)
                outbox.done(command)
        outbox.done(image)
    assert late < 0.05 * parts
    assert not command.lost


def test_a_flood_of_small_messages_leaves_the_large_ones_their_share() -> None:
    """Small messages overtake a large one only until their topic has had as many bytes."""
    outbox: Outbox[Message] = Outbox()
    image: Queue[Message] = outbox.open(Queue("image"))
    flood: Queue[Message] = outbox.open(Queue("flood", depth=None, limit_bytes=1 << 30))
    outbox.put(image, Message(b"i" * 1_000_000))
    taken = outbox.take(4, 0)
    assert taken is not None
    for _ in range(1000):
        outbox.put(flood, Message(b"f" * SMALL_BYTES))
    left, between = 1_000_000, 0
    while left > 0:
        if outbox.overtakes(4, image):
            small = outbox.take(4, 0, small=True)
            assert small is not None
            outbox.served(flood, SMALL_BYTES)
            outbox.done(flood)
            between += SMALL_BYTES
        else:
            outbox.served(image, 4000)
            left -= 4000
    assert 900_000 < between < 1_100_000


def test_a_topic_under_way_has_no_second_turn() -> None:
    """Of a topic whose message is being sent nothing else is taken, and what waits has its turn afterwards."""
    outbox: Outbox[Message] = Outbox()
    queue: Queue[Message] = outbox.open(Queue("t", depth=10))
    for i in range(2):
        outbox.put(queue, Message(b"%d" % i))
    assert outbox.take(4, 0) is not None
    assert outbox.take(4, 0) is None
    assert list(outbox.lanes()) == []
    outbox.done(queue)
    assert drain(outbox) == [b"1"]
    outbox.put(queue, Message(b"2"))
    assert outbox.take(4, 0) is not None
    outbox.close(queue)
    outbox.done(queue)
    outbox.put(queue, Message(b"3"))


def test_what_is_ready_is_taken_at_once_and_its_topic_charged() -> None:
    """A small message that is ready goes in one step, and its topic waits for its next turn as after any other."""
    outbox = Outbox[Message]()
    ready, other = outbox.open(Queue("ready", depth=10)), outbox.open(Queue("other", depth=10))
    ready.ready_bytes = other.ready_bytes = 10
    for body in (b"r1", b"r2"):
        outbox.put(ready, Message(body))
    outbox.put(other, Message(b"o1"))
    taken = [outbox.take_ready(100, 4, 0) for _ in range(3)]
    assert [item[1].payload for item in taken if item is not None] == [b"r1", b"o1", b"r2"]
    assert (outbox.messages, outbox.bytes, ready.served) == (0, 0, 12.0)


def test_what_is_not_ready_is_left_where_it_waits() -> None:
    """A message that is too large, for its topic or for the room there is, too old or big is not taken as ready."""
    outbox = Outbox[Message]()
    queue = outbox.open(Queue("ready", depth=1, lifespan_ns=100))
    queue.ready_bytes = 10
    outbox.put(queue, Message(b"x" * 11))
    assert outbox.take_ready(100, 4, 0) is None
    outbox.put(queue, Message(b"x" * 10))
    assert outbox.take_ready(9, 4, 0) is None
    assert outbox.take_ready(100, 4, 101) is None
    outbox.put(queue, Message(b"x" * (SMALL_BYTES + 1)))
    assert outbox.take_ready(1 << 20, 4, 0) is None
    assert outbox.messages == 1


def in_turns(*, ahead: bool) -> list[bytes]:
    """Return what is sent of three topics of different weights and sizes, with ``take_next`` or without."""
    outbox: Outbox[Message] = Outbox()
    chance = random.Random(7)
    queues = [
        outbox.open(Queue(name, depth=None, weight=weight)) for name, weight in (("a", 1.0), ("b", 3.0), ("c", 1.0))
    ]
    out: list[bytes] = []
    for number in range(400):
        size = chance.choice((10, 100, 1000, 2 * SMALL_BYTES))
        outbox.put(chance.choice(queues), Message(b"%5d" % number + bytes(size)))
        until = len(out) + chance.randrange(30) if number % 40 == 39 else 0
        taken = None
        while len(out) < until:
            taken = taken or outbox.take(4, 0)
            if taken is None:
                break
            queue, message = taken
            out.append(message.payload[:5])
            outbox.served(queue, len(message.payload))
            following = outbox.take_next(queue, 0) if ahead and len(out) < until else None
            taken = None if following is None else (queue, following)
            if taken is None:
                outbox.done(queue)
    return out + [payload[:5] for payload in drain(outbox)]


def test_what_follows_is_what_would_have_been_taken() -> None:
    """To take what follows of a topic at once changes no turn of any topic, whatever waits of the others."""
    assert in_turns(ahead=True) == in_turns(ahead=False)


def test_what_does_not_follow_at_once() -> None:
    """A big message, one that has expired, and what was kept while a topic is held wait for their turn."""
    outbox: Outbox[Message] = Outbox()
    for second in (Message(bytes(SMALL_BYTES + 1)), Message(b"old", stamp_ns=-10)):
        topic: Queue[Message] = outbox.open(Queue("t", depth=None, lifespan_ns=5))
        outbox.put(topic, Message(b"1"))
        outbox.put(topic, second)
        assert outbox.take(4, 0) is not None
        assert outbox.take_next(topic, 0) is None
        outbox.done(topic)
        outbox.close(topic)
    held: Queue[Message] = Queue("held", depth=None)
    outbox.adopt(held, [Message(b"1")])
    assert outbox.take_next(held, 0) is None
    outbox.done(held)
    assert drain(outbox) == [b"1"]
    assert outbox.take_next(held, 0) is None
