"""TypeRegistry: where definitions come from, and how they are named, joined and replaced."""

from __future__ import annotations

import re
import threading
from pathlib import Path

import pytest

from ropeway.errors import InvalidDefinition, InvalidTypeName, TypeConflict, UnknownType
from ropeway.types import MessageCodec, TypeRegistry

RULE = "=" * 80


def write(path: Path, text: str) -> Path:
    """Make a file and the directories above it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def test_names() -> None:
    """Names are known in both spellings, services and actions under their own names."""
    registry = TypeRegistry()
    assert registry.canonical("std_srvs/SetBool", "srv") == "std_srvs/srv/SetBool"
    assert registry.has("sensor_msgs/Image")
    assert registry.has("sensor_msgs/msg/Image")
    assert registry.has("std_srvs/SetBool", "srv")
    assert registry.has("std_srvs/srv/SetBool_Request")
    assert registry.has("example_interfaces/action/Fibonacci_GetResult_Response")
    assert not registry.has("sensor_msgs/Nothing")
    assert not registry.has("nonsense")
    assert "std_srvs/srv/SetBool" in registry.names("srv")
    assert "example_interfaces/action/Fibonacci" in registry.names("action")
    assert registry.names() == sorted({*registry.names("msg"), *registry.names("srv"), *registry.names("action")})
    assert not any(name.endswith("_Request") for name in registry.names())


def test_every_interface_is_complete() -> None:
    """Every known interface has a hash and a full text, and every part of it a codec."""
    registry = TypeRegistry("jazzy")
    for name in registry.names():
        assert registry.hash(name).startswith("RIHS01_")
        assert registry.full_text(name) is not None
        for part in [name, *registry.dependencies(name)]:
            if not registry.text(part).count("---") and not part.endswith(("_SendGoal", "_GetResult")):
                assert isinstance(registry.codec(part), MessageCodec)


def test_codec_is_made_once() -> None:
    """One codec serves all spellings of a name."""
    registry = TypeRegistry()
    assert registry.codec("sensor_msgs/Image") is registry.codec("sensor_msgs/msg/Image")
    assert registry.codec("/sensor_msgs//Image") is registry.codec("sensor_msgs.msg.Image")


def test_unknown_type() -> None:
    """An unknown type is told with the nearest known one, or with the type that needs it."""
    registry = TypeRegistry()
    with pytest.raises(UnknownType, match=r"sensor_msgs/msg/Imge is not known; did you mean sensor_msgs/msg/Image\?"):
        registry.codec("sensor_msgs/Imge")
    registry.add_text("p/msg/A", "q/Missing m\n")
    with pytest.raises(UnknownType, match=r"q/msg/Missing is not known \(needed by p/msg/A\)") as caught:
        registry.codec("p/A")
    assert caught.value.name == "q/msg/Missing"
    with pytest.raises(UnknownType):
        registry.full_text("p/A")
    with pytest.raises(UnknownType):
        registry.hash("p/A")
    with pytest.raises(InvalidTypeName):
        registry.codec("nonsense")


def test_distros_differ() -> None:
    """A registry knows the messages of the distribution it is named after."""
    fields = [field.name for field in TypeRegistry("humble").definition("rmw_dds_common/msg/Gid").fields]
    assert fields == ["data"]
    assert TypeRegistry("humble").codec("rmw_dds_common/msg/Gid").encode({}) != TypeRegistry("jazzy").codec(
        "rmw_dds_common/msg/Gid"
    ).encode({})
    with pytest.raises(ValueError, match="'melodic' is not a known ROS distribution"):
        TypeRegistry("melodic")


def test_same_layout_again() -> None:
    """The same layout again is nothing new, whatever the comments."""
    registry = TypeRegistry()
    codec = registry.codec("std_msgs/String")
    registry.add_text("std_msgs/msg/String", "# words\nstring data  # the text\n")
    assert registry.codec("std_msgs/String") is codec


def test_conflicts() -> None:
    """Another layout is refused, unless it replaces a built-in definition and is meant to."""
    registry = TypeRegistry()
    old = registry.codec("std_msgs/String")
    hashed = registry.hash("std_msgs/String")
    with pytest.raises(TypeConflict, match=r"already established with type \{string data\}, not \{int8 data\}"):
        registry.add_text("std_msgs/msg/String", "int8 data\n")
    registry.add_text("std_msgs/msg/String", "int8 data\n", replace=True)
    assert registry.codec("std_msgs/String").encode({"data": 5}) == b"\0\1\0\0\5"
    assert registry.hash("std_msgs/String") != hashed
    assert old.encode({"data": "x"})[-2:] == b"x\0"
    with pytest.raises(TypeConflict):
        registry.add_text("std_msgs/msg/String", "int16 data\n", replace=True)


def test_replaced_part_changes_what_uses_it() -> None:
    """A replaced message is replaced in those that contain it."""
    registry = TypeRegistry()
    before = registry.hash("geometry_msgs/Twist"), registry.full_text("geometry_msgs/Twist")
    registry.codec("geometry_msgs/Twist")
    registry.add_text("geometry_msgs/msg/Vector3", "int8 x\nint8 y\nint8 z\n", replace=True)
    assert registry.codec("geometry_msgs/Twist").encode({}) == b"\0\1\0\0" + bytes(6)
    assert (registry.hash("geometry_msgs/Twist"), registry.full_text("geometry_msgs/Twist")) != before


def test_faults_name_the_file(tmp_path: Path) -> None:
    """A definition that cannot be parsed is told with its file and line."""
    file = write(tmp_path / "p/msg/A.msg", "int8 a\nint8 b b b\n")
    registry = TypeRegistry()
    assert registry.add_path(file) == 1
    for _ in range(2):
        with pytest.raises(InvalidDefinition, match=r"A\.msg: the definition of p/msg/A cannot be used: line 2"):
            registry.codec("p/A")
    with pytest.raises(InvalidDefinition, match=r"^the definition of p/msg/A cannot be used: line 1"):
        registry.add_text("p/msg/A", "x")


def test_a_bad_definition_fails_alone(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Files that cannot be read are told once each; all others are known, and only what needs a bad one fails."""
    write(tmp_path / "p/msg/Good.msg", "int8 a\n")
    write(tmp_path / "p/msg/Bad.msg", "int8\n")
    write(tmp_path / "p/msg/Needs.msg", "Bad b\n")
    write(tmp_path / "p/srv/Bad.srv", "int8 a\n")
    write(tmp_path / "p/action/Bad.action", "---\n")
    write(tmp_path / "p/msg/Odd.idl", "module p { module msg { union Odd { }; }; };")
    write(tmp_path / "other/p/msg/Good.msg", "int16 a\n")
    registry = TypeRegistry()
    assert registry.add_path(tmp_path / "p") == 6
    assert registry.add_path(tmp_path / "other") == 1
    assert registry.codec("p/Good").default() == {"a": 0}
    assert len(caplog.records) == len(registry.faults) == 5
    for name in ("p/msg/Bad", "p/msg/Needs", "p/msg/Odd", "p/srv/Bad_Request", "p/action/Bad_Goal"):
        with pytest.raises(InvalidDefinition, match="cannot be used"):
            registry.codec(name)


def test_interfaces_in_idl(tmp_path: Path) -> None:
    """A service and an action in IDL are whole interfaces, whose text is that of a .srv and .action."""
    write(
        tmp_path / "p/srv/Turn.idl",
        "module p { module srv { struct Turn_Request { @default(value=2) long a; };"
        " struct Turn_Response { uint8 structure_needs_at_least_one_member; }; }; };",
    )
    write(
        tmp_path / "p/action/Park.idl",
        "module p { module action { struct Park_Goal { long a; }; struct Park_Result { long b; };"
        " struct Park_Feedback { long c; }; }; };",
    )
    registry, twin = TypeRegistry(), TypeRegistry()
    assert registry.add_path(tmp_path) == 2
    assert registry.text("p/srv/Turn") == "int32 a 2\n---\n"
    for name in ("p/srv/Turn", "p/action/Park"):
        twin.add_full_text(name, registry.full_text(name))
        assert twin.hash(name) == registry.hash(name)


def test_full_text_in_idl() -> None:
    """A concatenated text in IDL, as recordings have it, defines its types."""
    rule = "=" * 80
    registry = TypeRegistry()
    registry.add_full_text(
        "p/msg/A",
        f"{rule}\nIDL: p/msg/A\nmodule p {{ module msg {{ struct A {{ p::msg::B b; }}; }}; }};\n"
        f"{rule}\nIDL: p/msg/B\nmodule p {{ module msg {{ struct B {{ long x; }}; }}; }};\n",
    )
    assert registry.codec("p/A").default() == {"b": {"x": 0}}


def test_paths(tmp_path: Path) -> None:
    """Files and directories are read at once, and go before what is built in."""
    write(tmp_path / "p/msg/A.msg", "Header h\nOther o\n")
    write(tmp_path / "p/msg/Header.msg", "uint8 mine\n")
    write(tmp_path / "p/msg/Other.msg", "int8 x 3\n")
    write(tmp_path / "p/srv/S.srv", "int8 a\n---\nA b\n")
    write(tmp_path / "p/action/G.action", "int8 a\n---\nint8 b\n---\nint8 c\n")
    write(tmp_path / "p/msg/Only.idl", "module p { module msg { struct Only { octet x; }; }; };")
    single = write(tmp_path / "elsewhere/std_msgs/msg/Bool.msg", "uint8 data\n")
    registry = TypeRegistry()
    assert registry.add_path(tmp_path / "p") == 6
    assert registry.add_path(single) == 1
    assert registry.codec("p/A").default() == {"h": {"mine": 0}, "o": {"x": 3}}
    assert registry.codec("p/srv/S_Response").default() == {"b": {"h": {"mine": 0}, "o": {"x": 3}}}
    assert registry.codec("p/action/G_SendGoal_Request").default() == {"goal_id": {"uuid": bytes(16)}, "goal": {"a": 0}}
    assert registry.codec("p/Only").default() == {"x": 0}
    assert registry.codec("std_msgs/Bool").default() == {"data": 0}
    with pytest.raises(InvalidDefinition, match="no such file or directory"):
        registry.add_path(tmp_path / "nothing")


def test_workspaces(tmp_path: Path) -> None:
    """A sourced workspace is read when needed, its first prefix wins, and it goes before what is built in."""
    write(tmp_path / "one/share/p/msg/A.msg", "int8 from_one\n")
    write(tmp_path / "one/share/p/msg/Broken.msg", "int8\n")
    write(tmp_path / "two/share/p/msg/A.msg", "int8 from_two\n")
    write(tmp_path / "two/share/p/srv/S.srv", "int8 a\n---\nA b\n")
    write(tmp_path / "two/share/std_msgs/msg/String.msg", "# with a comment\nstring data\n")
    write(tmp_path / "two/share/std_msgs/msg/Bool.msg", "uint8 data\n")
    registry = TypeRegistry()
    registry.codec("std_msgs/Bool")
    environ = {"AMENT_PREFIX_PATH": f"{tmp_path / 'one'}:{tmp_path / 'two'}:{tmp_path / 'none'}:"}
    assert registry.add_ament_prefix_path(environ) == 5
    assert registry.add_ament_prefix_path({}) == 0
    assert {"p/msg/A", "p/srv/S"} <= set(registry.names())
    assert registry.codec("p/A").default() == {"from_one": 0}
    assert registry.codec("p/srv/S_Response").default() == {"b": {"from_one": 0}}
    assert registry.text("std_msgs/String").startswith("# with a comment")
    assert registry.codec("std_msgs/Bool").default() == {"data": 0}
    for _ in range(2):
        with pytest.raises(InvalidDefinition, match=r"Broken\.msg"):
            registry.codec("p/Broken")


def test_full_text() -> None:
    """A full text is the main one, then each dependency once under its heading."""
    registry = TypeRegistry()
    assert registry.full_text("std_msgs/Header") == (
        f"builtin_interfaces/Time stamp\nstring frame_id\n{RULE}\n"
        "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
    )
    assert registry.full_text("geometry_msgs/Twist").count("MSG: geometry_msgs/Vector3\n") == 1


@pytest.mark.parametrize(
    "name",
    [
        "sensor_msgs/msg/PointCloud2",
        "visualization_msgs/msg/InteractiveMarker",
        "std_msgs/msg/Empty",
        "rcl_interfaces/srv/SetParameters",
        "example_interfaces/action/Fibonacci",
        "example_interfaces/action/Fibonacci_SendGoal_Request",
    ],
)
def test_full_text_is_enough(name: str) -> None:
    """What one registry writes another, which has none of it, reads to the same hash."""
    registry = TypeRegistry()
    text, renamed = (re.sub(r"_(msgs|interfaces)/", r"_own\1/", text) for text in (registry.full_text(name), name))
    text = re.sub(r"builtin_own", "builtin_", text)
    other = TypeRegistry()
    other.add_full_text(renamed, text)
    assert other.full_text(renamed) == text
    fresh = TypeRegistry()
    fresh.add_full_text(name, registry.full_text(name))
    assert fresh.hash(name) == registry.hash(name)


def test_full_text_is_all_or_nothing() -> None:
    """A concatenated definition with a conflict or fault in it leaves nothing behind."""
    registry = TypeRegistry()
    with pytest.raises(TypeConflict):
        registry.add_full_text("p/msg/A", f"q/B b\n{RULE}\nMSG: q/B\nint8 x\n{RULE}\nMSG: std_msgs/String\nint8 x\n")
    with pytest.raises(InvalidDefinition):
        registry.add_full_text("p/msg/A", f"q/B b\n{RULE}\nMSG: q/B\nint8\n")
    with pytest.raises(TypeConflict):
        registry.add_full_text("p/msg/A", f"int8 a\n{RULE}\nMSG: p/A\nint16 a\n")
    assert not registry.has("p/A")
    assert not registry.has("q/B")


def test_ros1_full_text() -> None:
    """A definition of ROS 1, whose header has a seq, fits a registry of ROS 2."""
    text = f"Header header\nuint8 x\n{RULE}\nMSG: std_msgs/Header\nuint32 seq\ntime stamp\nstring frame_id\n"
    registry = TypeRegistry()
    registry.add_full_text("old_msgs/Thing", text)
    codec = registry.codec("old_msgs/Thing")
    assert codec.decode(codec.from_ros1(b"\7\0\0\0" + b"\1\0\0\0" + b"\2\0\0\0" + b"\1\0\0\0f" + b"\5")) == {
        "header": {"stamp": {"sec": 1, "nanosec": 2}, "frame_id": "f"},
        "x": 5,
    }


def test_parallel_use() -> None:
    """Many threads may read and add at once."""
    registry = TypeRegistry()
    names = registry.names("msg")
    failures: list[BaseException] = []

    def work(number: int) -> None:
        try:
            for index, name in enumerate(names[number::2]):
                codec = registry.codec(name)
                codec.decode(codec.encode({}))
                registry.hash(name)
                registry.add_text(f"p{number}/msg/T{index}", f"{name.replace('/msg/', '/')} x\n")
        except BaseException as error:
            failures.append(error)

    threads = [threading.Thread(target=work, args=(number % 2,)) for number in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert failures == []
