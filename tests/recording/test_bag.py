"""Recordings of every kind, written by the tests and read back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.interfaces import Qos, QosDurability, QosHistory, QosLiveliness, QosReliability, QosTime
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from ropeway.errors import BagUnreadable
from ropeway.qos import DEFAULT, LATCHED, QoS
from ropeway.recording.bag import Bag
from ropeway.types import TypeRegistry
from tests.support.messages import STRING
from tests.support.recordings import RECORDINGS

POINT = "geometry_msgs/msg/PointStamped"
SECOND = 10**9
NEVER = QosTime(2**31 - 1, 2**32 - 1)
LATE = Qos(
    QosHistory.KEEP_LAST, 1, QosReliability.RELIABLE, QosDurability.TRANSIENT_LOCAL,
    NEVER, NEVER, QosLiveliness.AUTOMATIC, NEVER, False,
)  # fmt: skip


def messages(registry: TypeRegistry) -> list[tuple[str, str, int, dict[str, Any]]]:
    """Four messages of two topics, a quarter of a second apart."""
    return [
        ("/text", STRING, SECOND, {"data": "one"}),
        ("/point", POINT, SECOND + SECOND // 4, {"header": {"stamp": {"sec": 7}}, "point": {"x": 1.0}}),
        ("/text", STRING, SECOND + SECOND // 2, {"data": "two"}),
        ("/point", POINT, SECOND + 3 * SECOND // 4, {"header": {"frame_id": "map"}, "point": {"x": 2.0}}),
    ]


def write_mcap(path: Path, registry: TypeRegistry, profile: str = "ros2", **options: Any) -> Path:
    """An MCAP file of either profile."""
    with path.open("wb") as file:
        writer = McapWriter(file, chunk_size=64, **options)
        writer.start(profile)
        channels: dict[str, int] = {}
        for topic, type, time_ns, values in messages(registry):
            codec = registry.codec(type)
            if topic not in channels:
                name = type if profile == "ros2" else type.replace("/msg/", "/")
                encoding = f"{profile}msg"
                schema = writer.register_schema(name, encoding, registry.full_text(type).encode())
                metadata = {"offered_qos_profiles": "- history: 1\n  depth: 3\n  reliability: 2\n  durability: 2\n"}
                channels[topic] = writer.register_channel(
                    topic,
                    "cdr" if profile == "ros2" else "ros1",
                    schema,
                    metadata if profile == "ros2" else {"latching": "1"},
                )
            cdr = codec.encode(values)
            writer.add_message(
                channels[topic], time_ns, cdr if profile == "ros2" else codec.ros1(cdr), publish_time=time_ns
            )
        writer.finish()
    return path


def write_rosbag2(path: Path, registry: TypeRegistry, plugin: StoragePlugin) -> Path:
    """A rosbag2 directory."""
    with Rosbag2Writer(path, version=9, storage_plugin=plugin) as writer:
        connections = {}
        for topic, type, time_ns, values in messages(registry):
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic,
                    type,
                    msgdef=registry.full_text(type),
                    rihs01=registry.hash(type),
                    offered_qos_profiles=[LATE] if topic == "/text" else [],
                )
            writer.write(connections[topic], time_ns, registry.codec(type).encode(values))
    return path


def write_rosbag1(path: Path, registry: TypeRegistry) -> Path:
    """A bag of ROS 1, of which /text is latched."""
    with Rosbag1Writer(path) as writer:
        connections = {}
        for topic, type, time_ns, values in messages(registry):
            codec = registry.codec(type)
            if topic not in connections:
                connections[topic] = writer.add_connection(
                    topic,
                    type,
                    msgdef=registry.full_text(type),
                    md5sum=registry.md5(type),
                    latching=int(topic == "/text"),
                )
            writer.write(connections[topic], time_ns, codec.ros1(codec.encode(values)))
    return path


WRITERS: dict[str, Callable[[Path, TypeRegistry], Path]] = {
    "mcap": lambda path, registry: write_mcap(path / "a.mcap", registry),
    "mcap-plain": lambda path, registry: write_mcap(
        path / "a.mcap", registry, use_chunking=False, compression=CompressionType.NONE
    ),
    "mcap-ros1": lambda path, registry: write_mcap(path / "a.mcap", registry, "ros1"),
    "rosbag2-sqlite3": lambda path, registry: write_rosbag2(path / "bag", registry, StoragePlugin.SQLITE3),
    "rosbag2-mcap": lambda path, registry: write_rosbag2(path / "bag", registry, StoragePlugin.MCAP),
    "db3": lambda path, registry: next(write_rosbag2(path / "bag", registry, StoragePlugin.SQLITE3).glob("*.db3")),
    "bag": lambda path, registry: write_rosbag1(path / "a.bag", registry),
}


@pytest.mark.parametrize("kind", WRITERS)
def test_every_kind_reads_the_same(kind: str, tmp_path: Path, registry: TypeRegistry) -> None:
    """The same messages come out of every kind of recording, as CDR and in order."""
    path = WRITERS[kind](tmp_path, registry)
    fresh = TypeRegistry()
    with Bag(path, fresh) as bag:
        assert {(t.name, t.type, t.count, t.problem) for t in bag.topics} == {
            ("/text", STRING, 2, ""),
            ("/point", POINT, 2, ""),
        }
        assert bag.start_ns == SECOND
        assert bag.duration_s == pytest.approx(0.75, abs=1e-6)
        for _ in range(2):
            read = [
                (r.topic.name, r.topic.type, r.time_ns, fresh.codec(r.topic.type).decode(r.payload))
                for r in bag.records()
            ]
            assert read == [
                (topic, type, time_ns, registry.codec(type).decode(registry.codec(type).encode(values)))
                for topic, type, time_ns, values in messages(registry)
            ]
        assert [r.time_ns for r in bag.records(["/text"])] == [SECOND, SECOND + SECOND // 2]
        assert list(bag.records(["/nothing"])) == []


def test_recorded_qos(tmp_path: Path, registry: TypeRegistry) -> None:
    """What was offered when it was recorded is offered again, and latched topics are latched."""
    expected = {
        "mcap": QoS(reliability="best_effort", depth=3),
        "mcap-ros1": LATCHED,
        "rosbag2-sqlite3": QoS(durability="transient_local", depth=1),
        "bag": LATCHED,
    }
    for kind, qos in expected.items():
        (tmp_path / kind).mkdir()
        with Bag(WRITERS[kind](tmp_path / kind, registry), TypeRegistry()) as bag:
            assert {t.name: t.qos for t in bag.topics}["/text"] == qos, kind


def write_one(path: Path, topic: str, type: str, encoding: str, schema: str, text: str, payload: bytes) -> Path:
    """An MCAP file with one message."""
    with path.open("wb") as file:
        writer = McapWriter(file)
        writer.start()
        number = writer.register_schema(type, schema, text.encode()) if type else 0
        writer.add_message(writer.register_channel(topic, encoding, number), SECOND, payload, SECOND)
        writer.finish()
    return path


def test_definitions_in_a_recording_become_known(tmp_path: Path) -> None:
    """A type that only the recording defines can be decoded afterwards."""
    registry = TypeRegistry()
    path = write_one(tmp_path / "a.mcap", "/x", "robot/msg/Mood", "cdr", "ros2msg", "uint8 level\n", b"\0\1\0\0\7")
    with Bag(path, registry) as bag:
        (record,) = bag.records()
    assert registry.codec("robot/msg/Mood").decode(record.payload) == {"level": 7}


def test_recordings_of_another_distribution(tmp_path: Path) -> None:
    """A message in the layout of Humble is played in that of the network, with or without its definition."""
    humble = TypeRegistry("humble", alone=True)
    name = "sensor_msgs/msg/Range"
    raw = humble.codec(name).encode({"range": 1.25})
    for schema in ("ros2msg", ""):
        registry = TypeRegistry()
        text = humble.full_text(name) if schema else ""
        path = write_one(tmp_path / "a.mcap", "/range", name, "cdr", schema, text, raw)
        with Bag(path, registry) as bag:
            (record,) = bag.records()
        assert record.payload == registry.codec(name).encode({"range": 1.25})


def test_recordings_of_another_version_of_a_package(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A type of the user's that has changed since it was recorded is played as it is now, by the names of fields."""
    registry, then = TypeRegistry(), TypeRegistry()
    registry.add_text("robot/msg/Mood", "float32 warmth 0.5\nuint8 level\n")
    then.add_text("robot/msg/Mood", "uint8 level\nstring why\n")
    raw = then.codec("robot/msg/Mood").encode({"level": 7, "why": "rain"})
    text = then.full_text("robot/msg/Mood")
    path = write_one(tmp_path / "a.mcap", "/x", "robot/msg/Mood", "cdr", "ros2msg", text, raw)
    with Bag(path, registry) as bag:
        (record,) = bag.records()
    assert registry.codec("robot/msg/Mood").decode(record.payload) == {"warmth": 0.5, "level": 7}
    assert caplog.messages == [
        "robot/msg/Mood.warmth is missing in a.mcap, filled with 0.5",
        "robot/msg/Mood.why of a.mcap is not known here and left out",
    ]


def test_types_of_a_recording_that_are_made_of_another_distributions(tmp_path: Path) -> None:
    """A type that only the recording defines, with Humble's Range in it, is played in the layouts of here."""
    humble, registry = TypeRegistry("humble", alone=True), TypeRegistry()
    humble.add_text("robot/msg/Scan", "sensor_msgs/Range[] ranges\n")
    raw = humble.codec("robot/msg/Scan").encode({"ranges": [{"range": 1.25}]})
    text = humble.full_text("robot/msg/Scan")
    path = write_one(tmp_path / "a.mcap", "/x", "robot/msg/Scan", "cdr", "ros2msg", text, raw)
    with Bag(path, registry) as bag:
        (record,) = bag.records()
    assert record.payload == registry.codec("robot/msg/Scan").encode({"ranges": [{"range": 1.25}]})


def test_ros1_types_that_changed_are_carried_over_by_name(tmp_path: Path) -> None:
    """CameraInfo of ROS 1 spells its matrices in capitals; their values arrive all the same."""
    registry = TypeRegistry()
    text = registry.full_text("sensor_msgs/msg/CameraInfo")
    for name in ("d", "k", "r", "p"):
        text = text.replace(f"] {name}\n", f"] {name.upper()}\n")
    assert "] K" in text
    theirs = TypeRegistry()
    theirs.add_full_text("sensor_msgs/msg/CameraInfo", text, replace=True)
    codec = theirs.codec("sensor_msgs/msg/CameraInfo")
    raw = codec.ros1(codec.encode({"K": [float(n) for n in range(9)], "height": 3}))
    path = write_one(tmp_path / "a.mcap", "/info", "sensor_msgs/CameraInfo", "ros1", "ros1msg", text, raw)
    with Bag(path, registry) as bag:
        (record,) = bag.records()
    message = registry.codec("sensor_msgs/msg/CameraInfo").decode(record.payload)
    assert list(message["k"]) == [float(n) for n in range(9)]
    assert message["height"] == 3


@pytest.mark.parametrize(
    ("topic", "type", "encoding", "words"),
    [
        ("/x", "a/msg/B", "json", "its messages are json, not CDR or ROS 1"),
        ("/x", "", "cdr", "is not a type name"),
        ("/3x", "std_msgs/msg/String", "cdr", "starts with a digit"),
        ("/x", "robot/Mood", "ros1", "the definition of robot/msg/Mood is not known"),
    ],
)
def test_topics_that_cannot_be_played(tmp_path: Path, topic: str, type: str, encoding: str, words: str) -> None:
    """A topic that makes no sense to us stands in the list with the reason, and is left out."""
    path = write_one(tmp_path / "a.mcap", topic, type, encoding, "", "", b"{}")
    with Bag(path, TypeRegistry()) as bag:
        assert words in bag.topics[0].problem
        assert list(bag.records()) == []


def test_messages_that_cannot_be_converted_are_counted(tmp_path: Path) -> None:
    """A damaged ROS 1 message is left out and counted."""
    path = write_one(tmp_path / "a.mcap", "/x", "std_msgs/String", "ros1", "ros1msg", "string data\n", b"\xff\0\0\0")
    with Bag(path, TypeRegistry()) as bag:
        assert list(bag.records()) == []
        assert bag.dropped == {"/x": 1}


def test_default_qos(tmp_path: Path) -> None:
    """Without a recorded profile a topic is reliable; static transforms are latched always."""
    for topic, qos in (("/x", DEFAULT), ("/robot/tf_static", LATCHED)):
        path = write_one(tmp_path / "a.mcap", topic, STRING, "cdr", "ros2msg", "string data\n", b"")
        with Bag(path, TypeRegistry()) as bag:
            assert bag.topics[0].qos == qos


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (b"", "a.x is empty"),
        (b"hello", "not a recording of a known kind"),
        (b"\x89MCAP0\r\n", "a.x"),
        (b"#ROSBAG V2.0\n", "a.x"),
        (b"SQLite format 3\0" + bytes(100), "a.x"),
    ],
)
def test_files_that_are_no_recordings(tmp_path: Path, content: bytes, words: str) -> None:
    """A file of another kind, or only the beginning of one, is refused with its name and the reason."""
    (tmp_path / "a.x").write_bytes(content)
    with pytest.raises(BagUnreadable, match=words), Bag(tmp_path / "a.x", TypeRegistry()):
        pass


def test_missing_files_and_directories(tmp_path: Path) -> None:
    """What is not there, and a directory without metadata, are refused."""
    with pytest.raises(BagUnreadable, match="no such file"), Bag(tmp_path / "none", TypeRegistry()):
        pass
    with pytest.raises(BagUnreadable, match=r"metadata\.yaml"), Bag(tmp_path, TypeRegistry()):
        pass


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(where=st.integers(0, 3000), new=st.binary(min_size=1, max_size=6), kind=st.sampled_from(["mcap", "bag", "db3"]))
def test_damaged_files_never_break_the_reader(
    tmp_path: Path, registry: TypeRegistry, where: int, new: bytes, kind: str
) -> None:
    """Any damage gives fewer messages or ``BagUnreadable``, and nothing else."""
    good = tmp_path / kind
    if not good.exists():
        good.mkdir()
        WRITERS[kind](good, registry)
    content = bytearray(next(p for p in good.rglob("*") if p.suffix in (".mcap", ".bag", ".db3")).read_bytes())
    content[where % len(content) : where % len(content) + len(new)] = new
    damaged = tmp_path / f"damaged.{kind}"
    damaged.write_bytes(content)
    try:
        with Bag(damaged, TypeRegistry()) as bag:
            assert len(list(bag.records())) <= 1000
    except BagUnreadable as error:
        assert str(damaged) in str(error)


@pytest.mark.data
@pytest.mark.skipif(not RECORDINGS.exists(), reason="needs recorded sensor data: name its directory in ROPEWAY_DATA")
@pytest.mark.parametrize(
    ("name", "count"),
    [
        ("dev.mcap", 8946),
        ("bags/scan_tools_demo.bag", 360),
        ("bags/obstacle_detector_test_tf_scan.bag", 6163),
        ("bags/ouster_512x10_raw_packets.bag", 43),
        ("bags/pointcloudset_ouster_os1.ros1.mcap", 273),
    ],
)
def test_real_recordings(name: str, count: int) -> None:
    """Real recordings are read to the last message, and what is decoded is of its type."""
    registry = TypeRegistry()
    with Bag(RECORDINGS / name, registry) as bag:
        last = 0
        read = 0
        for record in bag.records():
            assert record.time_ns >= last
            last = record.time_ns
            if read % 50 == 0:
                registry.codec(record.topic.type).decode(record.payload)
            read += 1
        assert read == count
        assert not bag.dropped
