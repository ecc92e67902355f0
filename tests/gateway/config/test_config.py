"""The configuration: what is accepted, what is refused and with which words."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.errors import ConfigError
from ropeway.gateway.config.config import Config, load, parse
from ropeway.gateway.config.route_fields import ENCODINGS
from ropeway.gateway.config.suggest import nearest
from ropeway.graph.base import Delivery
from ropeway.networks.rosbridge import protocol as wire
from ropeway.qos import QoS

LISTING_1 = [
    {
        "address": "ws://carol",
        "expose-service": [{"name": "/pause_robot", "type": "std_srvs/srv/Empty"}],
        "expose-action": [{"name": "/navigate_to_pose", "type": "nav2_msgs/action/NavigateToPose"}],
        "reserve-service": [{"name": "/controller_start", "type": "std_srvs/srv/SetBool"}],
    },
    {
        "address": "ws://alice",
        "publish": [{"name": "/image_raw", "type": "sensor_msgs/msg/Image", "compression": "cbor-raw"}],
        "subscribe": [
            {"name": "/face_recog_result", "type": "std_msgs/msg/String"},
            {"name": "/object_detect_result", "type": "std_msgs/msg/String"},
            {"name": "/human_act_recog_result", "type": "std_msgs/msg/String"},
        ],
    },
]

ROSGW = """
[
    {
        "title":"jackal1",
        "active": true,
        "address": "ws://172.28.165.227:9001",
        "publish": [
            {"name":"/kitti/camera_color_left/image_raw",
              "type":"sensor_msgs/msg/Image",
              "compression":"cbor-raw"
            }
        ],
        "subscribe": [
            {"name":"/cmd_vel", "type":"geometry_msgs/msg/Twist"}
        ]
    }
]
"""

FULL_YAML = """
$schema: ./ropeway.schema.json
gateway:
  name: robot1
  graphs: ["dds:0", "dds:7"]
  listen: []
  workers: per-remote
  types: [msgs]
  max_message_bytes: 1000000
remotes:
  - address: wss://cloud.example.org/robots
    graph: dds:7
    remote_namespace: /robot1
    tls: {ca: ca.pem, verify: false}
    publish:
      - {name: camera/image, type: sensor_msgs/Image, rate_hz: 15, priority: bulk, lifespan_s: 0.5, depth: 2, weight: 3}
      - {name: /tf, type: tf2_msgs/msg/TFMessage, remote_name: /tf, qos: {reliability: best_effort, depth: 100}}
    subscribe:
      - {name: /cmd_vel, type: geometry_msgs.msg.Twist, priority: command, encoding: none}
    trans-publish:
      - {name: /odom, type: nav_msgs/msg/Odometry, remote_name: odometry/wheel}
"""


def topic(name: str = "/a", type: str = "std_msgs/msg/String", **more: Any) -> dict[str, Any]:
    """An item for a topic."""
    return {"name": name, "type": type, **more}


def remote(**more: Any) -> dict[str, Any]:
    """A remote, with an address."""
    return {"address": "ws://h", **more}


def faults(obj: object) -> dict[str, str]:
    """The problems that ``parse`` raises, by path."""
    with pytest.raises(ConfigError) as caught:
        parse(obj, "robot.json")
    return dict(caught.value.problems)


def test_listing_1_of_the_paper_is_accepted() -> None:
    """The paper's first listing gives its seven tasks, at port 9090."""
    routes = parse(LISTING_1).routes()
    assert [(r.operation, r.kind, r.name, r.type, r.remote.address) for r in routes] == [
        ("expose-service", "service", "/pause_robot", "std_srvs/srv/Empty", "ws://carol:9090"),
        ("reserve-service", "service", "/controller_start", "std_srvs/srv/SetBool", "ws://carol:9090"),
        ("expose-action", "action", "/navigate_to_pose", "nav2_msgs/action/NavigateToPose", "ws://carol:9090"),
        ("publish", "topic", "/image_raw", "sensor_msgs/msg/Image", "ws://alice:9090"),
        ("subscribe", "topic", "/face_recog_result", "std_msgs/msg/String", "ws://alice:9090"),
        ("subscribe", "topic", "/object_detect_result", "std_msgs/msg/String", "ws://alice:9090"),
        ("subscribe", "topic", "/human_act_recog_result", "std_msgs/msg/String", "ws://alice:9090"),
    ]
    assert routes[3].options.delivery == Delivery(encoding="cbor-raw")
    assert routes[4].options.delivery == Delivery(encoding="auto")
    assert routes[3].options.qos is None


def test_graph_of_ros_domain_id(monkeypatch: pytest.MonkeyPatch) -> None:
    """Without graphs, the gateway stands on the domain that ROS is told to use; one that is none is a fault."""
    monkeypatch.delenv("ROS_DOMAIN_ID", raising=False)
    assert parse([]).gateway.graphs == ("dds:0",)
    monkeypatch.setenv("ROS_DOMAIN_ID", "42")
    assert parse([]).gateway.graphs == ("dds:42",)
    assert parse({"gateway": {"graphs": ["dds:3"]}}).gateway.graphs == ("dds:3",)
    monkeypatch.setenv("ROS_DOMAIN_ID", "seven")
    with pytest.raises(ConfigError, match=r'gateway.graphs: ROS_DOMAIN_ID is "seven"; expected a number from 0 to'):
        parse([])
    assert parse({"gateway": {"graphs": ["dds:3"]}}).gateway.graphs == ("dds:3",)


def test_networks_with_types_of_their_own(tmp_path: Path) -> None:
    """A graph may be an object with its distribution and files; a remote has both, too; both come back from JSON."""
    (tmp_path / "old").mkdir()
    document = {
        "gateway": {"graphs": ["dds:0", {"address": "dds:1", "distro": "humble", "types": ["old"]}]},
        "remotes": [{"address": "ws://h", "graph": "dds:1", "distro": "foxy", "publish": [topic()]}],
    }
    config = parse(document, directory=tmp_path)
    assert config.gateway.graphs == ("dds:0", "dds:1")
    first, second = config.gateway.networks
    assert (first.distro, first.types) == (None, ())
    assert (second.distro, second.types) == ("humble", (str(tmp_path / "old"),))
    assert config.remotes[0].distro == "foxy"
    assert config.routes()[0].graph == "dds:1"
    assert config.to_json()["gateway"]["graphs"][0] == "dds:0"
    assert parse(config.to_json()) == config


def test_networks_that_cannot_have_types_of_their_own() -> None:
    """A distribution stands only where it can count; one that is none is told with those that there are."""
    said = faults(
        {
            "gateway": {
                "graphs": [
                    {"address": "ros2", "distro": "humble"},
                    {"address": "dds:1", "distro": "hubmle"},
                    {"address": "dds:2?distro=humble", "distro": "foxy"},
                    {"address": "dds:1"},
                    7,
                ]
            },
            "remotes": [
                {"address": "iort://h", "distro": "humble"},
                {"address": "ws://h", "distro": "humble", "ros": 1},
            ],
        }
    )
    assert said["gateway.graphs[0].distro"] == (
        "only dds and zenoh graphs have this key; ros2 has the types of the ROS 2 that is sourced"
    )
    assert said["gateway.graphs[1].distro"].startswith("expected one of foxy, galactic, humble")
    assert said["gateway.graphs[2].distro"] == "dds:2?distro=humble says it, too; keep one"
    assert said["gateway.graphs[3]"] == "the same network as gateway.graphs[1]; keep one"
    assert said["gateway.graphs[4]"] == "expected a graph such as dds:0, or an object with its address, got 7"
    assert said["remotes[0].distro"] == "only ws:// and wss:// remotes have this key, and this is iort://h"
    assert said["remotes[1].distro"] == 'a remote of ROS 1 has no layouts of ROS 2; leave this or "ros": 1 out'


def test_rosgw_example_is_accepted(tmp_path: Path) -> None:
    """The example file of rosgw loads as it stands."""
    file = tmp_path / "example_cfg.json"
    file.write_text(ROSGW)
    config = load(file)
    assert [(r.path, r.name) for r in config.routes()] == [
        ("remotes[0].publish[0]", "/kitti/camera_color_left/image_raw"),
        ("remotes[0].subscribe[0]", "/cmd_vel"),
    ]
    assert config.remotes[0].title == "jackal1"
    assert config.remotes[0].address == "ws://172.28.165.227:9001"


def test_one_remote_alone_is_accepted() -> None:
    """One remote object without a list means the same as a list of one."""
    assert parse(LISTING_1[1]) == parse([LISTING_1[1]])


def test_full_form_in_yaml(tmp_path: Path) -> None:
    """The full form loads from YAML, with files found beside it."""
    (tmp_path / "msgs").mkdir()
    (tmp_path / "ca.pem").write_text("")
    file = tmp_path / "robot.yaml"
    file.write_text(FULL_YAML)
    config = load(file)
    assert config.gateway.graphs == ("dds:0", "dds:7")
    assert config.gateway.workers == "per-remote"
    assert config.gateway.types == (str(tmp_path / "msgs"),)
    assert config.gateway.max_message_bytes == 1_000_000
    image, tf, cmd, odom = config.routes()[0], config.routes()[1], config.routes()[2], config.routes()[3]
    assert (image.name, image.remote_name) == ("/camera/image", "/robot1/camera/image")
    assert image.type == "sensor_msgs/msg/Image"
    assert image.options.delivery == Delivery(
        encoding="auto", priority=7, rate_hz=15.0, lifespan_s=0.5, depth=2, weight=3.0
    )
    assert image.remote.address == "wss://cloud.example.org:9090/robots"
    assert (image.graph, image.remote.tls and image.remote.tls.verify) == ("dds:7", False)
    assert (tf.remote_name, tf.options.qos) == ("/tf", QoS(reliability="best_effort", depth=100))
    assert (cmd.operation, cmd.type, cmd.options.delivery) == (
        "subscribe",
        "geometry_msgs/msg/Twist",
        Delivery(encoding="none", priority=0),
    )
    assert (odom.operation, odom.name, odom.remote_name) == ("trans-publish", "/odom", "/robot1/odometry/wheel")


def test_defaults() -> None:
    """An empty object is a gateway that serves rosbridge clients of this machine on domain 0."""
    config = parse({})
    gateway = config.gateway
    assert (gateway.graphs, gateway.listen, gateway.workers) == (("dds:0",), ("ws://127.0.0.1:9090",), 0)
    assert gateway.max_message_bytes == 64 << 20
    assert re.fullmatch(r"[A-Za-z_]\w*", gateway.name)
    assert config.routes() == []


@pytest.mark.parametrize("host", ["bob-laptop.lan", "7of9", "日本", "-"])
def test_name_from_any_host_name(monkeypatch: pytest.MonkeyPatch, host: str) -> None:
    """The default name is a valid part of a ROS name whatever the host is called."""
    monkeypatch.setattr("socket.gethostname", lambda: host)
    name = parse({}).gateway.name
    assert re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", name)
    assert parse({"gateway": {"name": name}}).gateway.name == name


@pytest.mark.parametrize(
    ("given", "normal"),
    [
        ("ws://h", "ws://h:9090"),
        ("WS://Host:9001/", "ws://host:9001"),
        ("wss://h.example.org/a/b?x=1", "wss://h.example.org:9090/a/b?x=1"),
        ("ws://[::1]", "ws://[::1]:9090"),
        ("ws://robot_1:80", "ws://robot_1:80"),
    ],
)
def test_addresses_get_one_spelling(given: str, normal: str) -> None:
    """Addresses without a port mean 9090, and case does not count."""
    assert parse({"address": given}).remotes[0].address == normal


@pytest.mark.parametrize(
    "bad",
    [
        "h:9090",
        "http://h",
        "ws://",
        "ws://<address of Host Carol>",
        "ws://h:99999",
        "ws://h:0",
        "ws://u:p@h",
        "ws://h#x",
    ],
)
def test_what_is_no_address(bad: str) -> None:
    """A text that is no address of a link is refused with an example of one."""
    said = faults(remote(address=bad))["remotes[0].address"]
    assert "ws://" in said or "user name" in said or "port" in said


@pytest.mark.parametrize(
    ("israw", "encoding"),
    [
        (True, "cbor-raw"),
        (1, "cbor-raw"),
        ("yes", "cbor-raw"),
        (False, "zip"),
        ("False", "zip"),
        ("false", "zip"),
        (None, "zip"),
    ],
)
def test_israw(israw: object, encoding: str) -> None:
    """A true ``israw`` stands for cbor-raw; false and the text "False" leave the compression as it is."""
    routes = parse(remote(publish=[topic(israw=israw, compression="zip")])).routes()
    assert routes[0].options.delivery.encoding == encoding


@pytest.mark.parametrize(("active", "count"), [(True, 1), (False, 0), ("false", 0), ("False", 0), ("true", 1)])
def test_active(active: object, count: int) -> None:
    """False, also as a text, keeps a remote from being started."""
    assert len(parse(remote(active=active, publish=[topic()])).routes()) == count


@pytest.mark.parametrize("type", ["std_msgs/msg/String", "std_msgs/String", "std_msgs.msg.String"])
def test_spellings_of_a_type(type: str) -> None:
    """All three spellings of a message type mean one type."""
    assert parse(remote(publish=[{"name": "/a", "messageType": type}])).routes()[0].type == "std_msgs/msg/String"


def test_spellings_of_services_and_actions() -> None:
    """Services and actions may be written with the key names of rosgw's REST interface."""
    config = parse(
        remote(
            **{
                "expose-service": [{"service": "/s", "serviceType": "std_srvs/Empty"}],
                "reserve-action": [{"action": "/n", "actionType": "nav2_msgs/NavigateToPose"}],
            }
        )
    )
    assert [(r.name, r.type) for r in config.routes()] == [
        ("/s", "std_srvs/srv/Empty"),
        ("/n", "nav2_msgs/action/NavigateToPose"),
    ]


def test_namespaces() -> None:
    """Namespaces stand before both names; a remote name with a slash is final."""
    config = parse(
        remote(
            local_namespace="robot",
            remote_namespace="/fleet/r1/",
            publish=[topic("/a"), topic("b", remote_name="c"), topic("d", remote_name="/e")],
        )
    )
    assert [(r.name, r.remote_name) for r in config.routes()] == [
        ("/robot/a", "/fleet/r1/a"),
        ("/robot/b", "/fleet/r1/c"),
        ("/robot/d", "/e"),
    ]


def test_every_fault_is_reported_in_one_line() -> None:
    """All faults of a file come together, each one line with path, expectation and nearest key."""
    said = faults(
        {
            "gateway": {"wokers": 2, "workers": "two", "graphs": ["dds:300"], "name": "a-b", "max_message_bytes": True},
            "remotes": [
                {
                    "address": "ws://h",
                    "publish": [topic(), topic(), topic("/c", compresion="zip"), topic("x y", "String"), 3],
                    "subscribe": topic(),
                    "expose-servce": [],
                },
                {"adress": "ws://h"},
            ],
        }
    )
    assert said["gateway.wokers"].startswith('unknown key; did you mean "workers"? Expected one of name, graphs,')
    assert said["gateway.workers"] == 'expected 0 (one process), up to 256 processes or "per-remote", got "two"'
    assert said["gateway.graphs[0]"] == 'expected a DDS domain from 0 to 232, got "dds:300"'
    assert said["gateway.name"] == 'expected letters, digits and _, not starting with a digit, got "a-b"'
    assert said["gateway.max_message_bytes"] == "expected a whole number, got true"
    assert 'did you mean "compression"?' in said["remotes[0].publish[2].compresion"]
    assert said["remotes[0].publish[3].name"].startswith('expected a ROS name such as /camera/image, got "x y": part')
    assert said["remotes[0].publish[3].type"] == 'expected the type of a topic, pkg/msg/Name, got "String"'
    assert said["remotes[0].publish[4]"] == "expected an object, got 3"
    assert said["remotes[0].subscribe"] == "expected a list, got an object"
    assert 'did you mean "expose-service"?' in said["remotes[0].expose-servce"]
    assert said["remotes[1].address"] == (
        "this key is missing; expected ws://host:port or wss://host:port, overlay: everybody in the overlay, "
        "iort://host:port: a server of IoRT nodes, or mqtt://host:port or mqtts://host:port: an MQTT broker; "
        "a list of ws:// or wss:// addresses that offer the same is a group"
    )
    assert 'did you mean "address"?' in said["remotes[1].adress"]
    assert said["remotes[0].publish[1]"] == (
        "the same task as remotes[0].publish[0] (topic /a, std_msgs/msg/String, ws://h:9090); keep one"
    )
    assert len(said) == 14
    assert not any("\n" in text for text in said.values())


@pytest.mark.parametrize(
    ("item", "where", "words"),
    [
        ({"type": "a/B"}, ".name", "missing"),
        (topic(compression="cbro-raw"), ".compression", 'did you mean "cbor-raw"?'),
        (topic(encoding="js-buffer"), ".encoding", "expected one of auto, none"),
        (topic(compression=["zip"]), ".compression", "expected a text, got a list"),
        (topic(encoding="zip", compression="zip"), ".encoding", 'another spelling of "compression"'),
        (topic(messageType="std_msgs/msg/String"), ".messageType", 'another spelling of "type"'),
        (topic(type="std_srvs/srv/Empty"), ".type", "expected the type of a topic"),
        (topic(priority=8), ".priority", "expected a number up to 7, got 8"),
        (topic(priority="comand"), ".priority", 'did you mean "command"?'),
        (topic(rate_hz=0), ".rate_hz", "expected a number above 0, got 0"),
        (topic(rate_hz="15"), ".rate_hz", 'expected a number, got "15"'),
        (topic(rate_hz=float("inf")), ".rate_hz", "finite"),
        (topic(depth=0), ".depth", "expected a number from 1, got 0"),
        (topic(depth=1.5), ".depth", "expected a whole number, got 1.5"),
        (topic(qos="sensor"), ".qos", "expected an object"),
        (topic(qos={"relability": "reliable"}), ".qos.relability", 'did you mean "reliability"?'),
        (topic(qos={"reliability": "maybe"}), ".qos", "Valid options are: reliable, best_effort"),
        (topic(remote_name="a//b"), ".remote_name", "empty part"),
        (topic("~/x"), ".name", "private names"),
        (topic("/3d/x"), ".name", "starts with a digit"),
    ],
)
def test_faults_of_an_item(item: dict[str, Any], where: str, words: str) -> None:
    """Each fault of an item names its own path and what was expected there."""
    said = faults([remote(publish=[item])])
    assert list(said) == [f"remotes[0].publish[0]{where}"]
    assert words in said[f"remotes[0].publish[0]{where}"]


def test_options_of_topics_are_refused_on_services() -> None:
    """A rate makes no sense for a service, so it is an unknown key there."""
    said = faults(remote(**{"expose-service": [{"name": "/s", "type": "a/B", "rate_hz": 3}]}))
    assert "unknown key" in said["remotes[0].expose-service[0].rate_hz"]


def test_trans_publish_needs_a_remote_name() -> None:
    """Without the other name there is nothing to rename."""
    said = faults(remote(**{"trans-publish": [topic()]}))
    assert "missing" in said["remotes[0].trans-publish[0].remote_name"]


def test_a_duplicate_task_is_refused_across_remotes_and_spellings() -> None:
    """The same class, address, name and type is one task, however it is written."""
    said = faults(
        [
            remote(publish=[topic(type="std_msgs/String", compression="zip")]),
            remote(address="WS://H:9090/", publish=[topic("a")]),
        ]
    )
    assert said == {
        "remotes[1].publish[0]": "the same task as remotes[0].publish[0] "
        "(topic /a, std_msgs/msg/String, ws://h:9090); keep one"
    }


@pytest.mark.parametrize(
    "second",
    [
        remote(subscribe=[topic()]),
        remote(address="ws://other", publish=[topic()]),
        remote(publish=[topic(type="std_msgs/msg/Int8")]),
        remote(publish=[topic(remote_name="/b")]),
        remote(active=False, publish=[topic()]),
        remote(graph="dds:1", publish=[topic()]),
    ],
)
def test_what_is_no_duplicate(second: dict[str, Any]) -> None:
    """Another direction, address, type, remote name or network, or an inactive remote, is another task."""
    config = parse({"gateway": {"graphs": ["dds:0", "dds:1"]}, "remotes": [remote(publish=[topic()]), second]})
    routes = config.routes()
    assert len({route.key for route in routes}) == len(routes)


def test_trans_publish_to_the_same_name_is_a_duplicate_of_publish() -> None:
    """Renaming to the same name is publishing."""
    said = faults(remote(publish=[topic()], **{"trans-publish": [topic(remote_name="/a")]}))
    assert "the same task as remotes[0].publish[0]" in said["remotes[0].trans-publish[0]"]


def test_keys_are_stable() -> None:
    """A route's key depends on what the task is and not on where or how it is written."""
    one = parse(remote(publish=[topic(rate_hz=3), topic("/b")])).routes()[1]
    two = parse([remote(publish=[topic("b", "std_msgs/String")])]).routes()[0]
    assert one.key == two.key
    assert one.path != two.path


@pytest.mark.parametrize("listen", ["ws://0.0.0.0:9090", "ws://192.168.1.5", "ws://[::]:9090", "ws://robot:9090"])
def test_an_open_listener_must_be_meant(listen: str) -> None:
    """A listener that others reach is refused unless the configuration says that it is insecure."""
    said = faults({"gateway": {"listen": [listen]}})
    assert '"insecure": true' in said["gateway.listen[0]"]
    assert parse({"gateway": {"listen": [listen], "insecure": True}}).gateway.listen


@pytest.mark.parametrize("listen", ["ws://127.0.0.1", "ws://localhost:0", "ws://[::1]:9000", "ws://127.3.2.1:1"])
def test_a_listener_for_this_machine_needs_nothing(listen: str) -> None:
    """Loopback listeners are allowed as they are."""
    assert parse({"gateway": {"listen": [listen]}}).gateway.listen


def test_a_listener_that_asks_for_certificates_is_guarded(tmp_path: Path) -> None:
    """Over wss:// with an authority, clients are known by their certificates, so nothing is insecure."""
    pem = tmp_path / "k.pem"
    pem.write_text("")
    tls = {"certificate": str(pem), "key": str(pem)}
    listen = ["wss://0.0.0.0:9090"]
    assert parse({"gateway": {"listen": listen, "tls": {**tls, "ca": str(pem)}}}).gateway.tls
    assert "insecure" in faults({"gateway": {"listen": listen, "tls": tls}})["gateway.listen[0]"]


def test_tls_needs_what_belongs_to_it(tmp_path: Path) -> None:
    """TLS without wss://, a listener without certificate, and half a key pair are faults."""
    pem = tmp_path / "k.pem"
    pem.write_text("")
    said = faults(
        {
            "gateway": {"listen": ["wss://127.0.0.1:1"]},
            "remotes": [remote(tls={"key": str(pem)}), {"address": "wss://h", "tls": {"ca": "/nowhere.pem"}}],
        }
    )
    assert "gateway.tls" in said["gateway.listen[0]"]
    assert "wss://" in said["remotes[0].tls"]
    assert "key is of no use" in said["remotes[0].tls.certificate"]
    assert said["remotes[1].tls.ca"] == 'expected an existing file or directory, "/nowhere.pem" does not exist'


def test_a_remote_stands_on_a_known_graph() -> None:
    """The graph of a remote is one of the gateway's."""
    said = faults({"gateway": {"graphs": ["dds:0"]}, "remotes": [remote(graph="dds:3")]})
    assert said["remotes[0].graph"].startswith("expected one of gateway.graphs (dds:0), got dds:3")


@pytest.mark.parametrize(
    ("value", "words"),
    [(None, "empty"), (3, "expected a list of remotes"), ("ws://h", "expected a list"), ([3], "expected an object")],
)
def test_what_is_no_configuration_at_all(value: object, words: str) -> None:
    """A value of another shape is refused with the shapes that are meant."""
    assert words in " ".join(faults(value).values())


def test_typos_at_the_top_are_understood() -> None:
    """A misspelt top key is told apart from a misspelt remote."""
    assert 'did you mean "remotes"?' in faults({"remote": []})["remote"]
    assert 'did you mean "address"?' in faults({"adress": "ws://h"})["remotes[0].adress"]


@pytest.mark.parametrize(
    ("name", "text", "words"),
    [
        ("a.json", '{"remotes": [', "a.json: line 1 column 14: not JSON: expecting value"),
        ("a.json", '{"a": {"b": 1,\n "b": 2}}', "a.json: a.b: this key stands twice"),
        ("a.json", '{"gateway": {"max_message_bytes": NaN}}', "NaN is not a JSON number"),
        ("a.yaml", "remotes:\n  - address: [", "a.yaml: line 2 column 15: not YAML"),
        ("a.yaml", "gateway:\n  name: a\n  name: b\n", "line 3 column 3: not YAML: the key 'name' stands twice"),
        ("a.yml", "a: !!python/name:os.system\n", "could not determine a constructor"),
        ("a.conf", "[" * 100_000, "nested too deeply"),
        ("a.conf", "[" * 3000 + "]" * 3000, "nested too deeply"),
    ],
)
def test_malformed_files(tmp_path: Path, name: str, text: str, words: str) -> None:
    """A file that cannot be parsed is refused with line and column, or the path of the repeated key."""
    (tmp_path / name).write_text(text)
    with pytest.raises(ConfigError, match=re.escape(words)):
        load(tmp_path / name)


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    """A missing file and one that is not text are configuration errors too."""
    with pytest.raises(ConfigError, match="No such file"):
        load(tmp_path / "none.json")
    (tmp_path / "bin.json").write_bytes(b"\xff\xfe")
    with pytest.raises(ConfigError, match="not UTF-8"):
        load(tmp_path / "bin.json")


def test_yaml_follows_its_newer_rules(tmp_path: Path) -> None:
    """``on`` is a text and ``1e-1`` a number, as in YAML 1.2."""
    file = tmp_path / "a.yaml"
    file.write_text("address: ws://h\ntitle: on\npublish: [{name: /a, type: a/B, lifespan_s: 1e-1}]\n")
    config = load(file)
    assert config.remotes[0].title == "on"
    assert config.routes()[0].options.delivery.lifespan_s == 0.1


def test_round_trip_and_slices(tmp_path: Path) -> None:
    """A configuration survives its JSON form; a slice keeps the paths and keys of the whole."""
    (tmp_path / "msgs").mkdir()
    (tmp_path / "ca.pem").write_text("")
    (tmp_path / "robot.yaml").write_text(FULL_YAML)
    whole = load(tmp_path / "robot.yaml")
    assert parse(json.loads(json.dumps(whole.to_json()))) == whole
    config = parse({"gateway": {"listen": ["ws://127.0.0.1:0"]}, "remotes": LISTING_1})
    part = parse(json.loads(json.dumps(config.slice([1], listen=False).to_json())))
    assert part.routes() == config.routes()[3:]
    assert part.gateway.listen == ()
    assert config.slice([1]).gateway.listen == ("ws://127.0.0.1:0",)


def test_encodings_are_those_of_the_wire() -> None:
    """Every encoding that the wire speaks can be asked for, and auto."""
    assert sorted(ENCODINGS) == sorted({"auto", *wire.ENCODINGS})


def test_models_are_frozen() -> None:
    """A configuration cannot be changed in place."""
    config = parse({})
    with pytest.raises(ValueError, match="frozen"):
        config.gateway.name = "other"


json_values = st.recursive(
    st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=8),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(
                [
                    "gateway",
                    "remotes",
                    "address",
                    "publish",
                    "name",
                    "type",
                    "qos",
                    "tls",
                    "graphs",
                    "listen",
                    "graph",
                    "x",
                ]
            ),
            inner,
            max_size=4,
        )
    ),
    max_leaves=25,
)


@given(json_values)
def test_no_value_breaks_the_parser(value: Any) -> None:
    """Whatever JSON a file holds, it is accepted or refused with one-line problems."""
    try:
        config = parse(value)
    except ConfigError as error:
        assert error.problems
        assert all(path and text and "\n" not in path + text for path, text in error.problems)
    else:
        assert parse(config.to_json()) == config


@pytest.mark.parametrize(
    ("word", "near"),
    [("adress", "address"), ("trans_publish", "trans-publish"), ("Publish", "publish"), ("zzz", ""), (3, "")],
)
def test_nearest(word: object, near: str) -> None:
    """A mistyped word finds the one that was meant, a strange one none."""
    assert nearest(word, ["address", "publish", "trans-publish", "subscribe"]) == near


# ---------------------------------------------------------------------------------------------------- schema


def conforms(value: Any, schema: Any, root: dict[str, Any]) -> bool:
    """A validator for the part of JSON Schema that ours uses."""
    if schema is True or schema == {}:
        return True
    known = {"$ref", "anyOf", "oneOf", "allOf", "not", "enum", "const", "type", "properties", "required", "items"}
    known |= {"additionalProperties", "minimum", "maximum", "exclusiveMinimum", "pattern", "default", "description"}
    known |= {"$schema", "$defs", "title"}
    assert set(schema) <= known, set(schema) - known
    if "$ref" in schema and not conforms(value, root["$defs"][schema["$ref"].rpartition("/")[2]], root):
        return False
    if "anyOf" in schema and not any(conforms(value, s, root) for s in schema["anyOf"]):
        return False
    if "oneOf" in schema and sum(conforms(value, s, root) for s in schema["oneOf"]) != 1:
        return False
    if not all(conforms(value, s, root) for s in schema.get("allOf", [])):
        return False
    if "not" in schema and conforms(value, schema["not"], root):
        return False
    if "enum" in schema and value not in schema["enum"]:
        return False
    if "const" in schema and value != schema["const"]:
        return False
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    types = {
        "object": isinstance(value, dict),
        "array": isinstance(value, list),
        "string": isinstance(value, str),
        "boolean": isinstance(value, bool),
        "null": value is None,
        "number": number,
        "integer": number and value == int(value),
    }
    if "type" in schema and not types[schema["type"]]:
        return False
    if isinstance(value, str) and not re.search(schema.get("pattern", ""), value):
        return False
    if number:
        if value < schema.get("minimum", value) or value > schema.get("maximum", value):
            return False
        if "exclusiveMinimum" in schema and value <= schema["exclusiveMinimum"]:
            return False
    if isinstance(value, list):
        return all(conforms(item, schema.get("items", True), root) for item in value)
    if isinstance(value, dict):
        properties = schema.get("properties", {})
        if not set(schema.get("required", [])) <= set(value):
            return False
        if schema.get("additionalProperties") is False and set(value) - set(properties):
            return False
        return all(conforms(item, properties[key], root) for key, item in value.items() if key in properties)
    return True


ACCEPTED: list[Any] = [
    {},
    LISTING_1,
    LISTING_1[0],
    json.loads(ROSGW),
    parse(LISTING_1).to_json(),
    remote(
        active="False",
        publish=[topic(israw=1, priority="bulk", encoding="zip", qos={"deadline": {"secs": 1, "nsecs": 0}})],
    ),
    remote(publish=[{"name": "/a", "messageType": "a/B", "depth": 3}], subscribe=[topic(priority=7, rate_hz=0.5)]),
    remote(
        **{
            "reserve-action": [{"action": "/n", "actionType": "a/B"}],
            "expose-service": [{"service": "/s", "type": "a/B"}],
        }
    ),
    {"$schema": "x", "gateway": {"workers": 3, "name": "a", "listen": [], "graphs": ["dds:1"]}},
    {"gateway": {"workers": "per-remote"}, "remotes": []},
]
REFUSED: list[Any] = [
    3,
    [3],
    {"gateway": {"wokers": 3}},
    {"gateway": {"workers": "two"}},
    {"gateway": {"name": "a-b"}},
    {"remotes": {}},
    {"title": "no address"},
    remote(publish=[topic(messageType="a/B")]),
    remote(publish=[topic(compression="zip", encoding="zip")]),
    remote(publish=[{"name": "/a"}]),
    remote(publish=[topic(rate_hz=0)]),
    remote(publish=[topic(compression="zap")]),
    remote(publish=[topic(priority=9)]),
    remote(publish=[topic(qos={"x": 1})]),
    remote(**{"trans-publish": [topic()]}),
    remote(**{"expose-service": [topic(rate_hz=3)]}),
]


@pytest.mark.parametrize("value", ACCEPTED, ids=repr)
def test_schema_accepts_what_the_parser_accepts(value: Any) -> None:
    """Every accepted form is valid by the JSON Schema."""
    schema = Config.schema()
    parse(value)
    assert conforms(value, schema, schema)


@pytest.mark.parametrize("value", REFUSED, ids=repr)
def test_schema_refuses_what_the_parser_refuses(value: Any) -> None:
    """A value of the wrong shape is invalid by the JSON Schema too."""
    schema = Config.schema()
    assert faults(value)
    assert not conforms(value, schema, schema)


def test_schema_describes_every_key() -> None:
    """An editor can explain every key."""
    for name, definition in Config.schema()["$defs"].items():
        for key, rule in definition.get("properties", {}).items():
            assert "description" in rule or "$ref" in rule or "anyOf" in rule or name == "Duration", (name, key)
