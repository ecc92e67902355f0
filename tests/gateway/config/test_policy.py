"""ropeway.gateway.config.policy: FogROS2-LS's policy files, as they are printed and as they are mistyped."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import yaml

from ropeway.errors import ConfigError
from ropeway.gateway.config import config
from ropeway.gateway.config.policy import policies_of

LISTING = """
  # III.B
  state_definition:
      standby: # do not publish or subscribe to any topics
      service:
          topics:
              - /yolo/input: sub # subscribes to YOLO input
              - /yolo/output: pub # publish to YOLO output
      robot:
          topics:
             - /yolo/input: pub # subscribes to YOLO input
             - /yolo/output: sub # publish to YOLO output
      params:
         - /camera: rgb_module.profile:=640x480x30

      initial_policy:
         turtlebot: robot
         machine_edge: service
         machine_cloud: standby

      # Section III.C Adaptive Latency Monitoring
      latency_bound:
         median: 0.3 # in second, max/min/median/mean/stddev
"""
EDGE, CLOUD = "ws://edge:9090", "ws://cloud:9090"
CROSSING: dict[str, Any] = {
    "publish": [{"name": "/yolo/input", "type": "sensor_msgs/msg/CompressedImage"}],
    "subscribe": [{"name": "/yolo/output", "type": "std_msgs/msg/String"}],
}


def group(anycast: object) -> dict[str, Any]:
    """Return a remote that is a group with this policy."""
    return {"address": [EDGE, CLOUD], "anycast": anycast, **CROSSING}


def listing(**changes: Any) -> dict[str, Any]:
    """Return the listing with some keys changed."""
    found: dict[str, Any] = yaml.safe_load(LISTING)
    return found | changes


def problems(obj: object, directory: Path = Path()) -> dict[str, str]:
    """Return what is wrong with a configuration, by path."""
    with pytest.raises(ConfigError) as caught:
        config.parse(obj, directory=directory)
    return dict(caught.value.problems)


@pytest.mark.parametrize("beside", [False, True])
def test_the_listing_as_printed(beside: bool) -> None:
    """Listing 1 is taken as it is printed, and with params, policy and bound beside the definition of the states."""
    read = yaml.safe_load(LISTING)
    if beside:
        states = read["state_definition"]
        read |= {key: states.pop(key) for key in ("params", "initial_policy", "latency_bound")}
    made = config.parse([group(read)])
    anycast = made.remotes[0].anycast
    assert anycast is not None
    assert dict(anycast.latency_bound.limits) == {"median": 0.3}
    assert anycast.pairs == {"/yolo/input": "/yolo/output"}
    policies = policies_of(made.remotes[0], "turtlebot")
    assert policies.initial == {EDGE: "service", CLOUD: "standby"}
    assert policies.states["robot"].params == {"/camera": {"rgb_module.profile": "640x480x30"}}
    assert policies.states["standby"].topics == {}
    assert policies.mine == "robot"


@pytest.mark.parametrize("place", ["file", "everywhere", "here"])
def test_places(place: str, tmp_path: Path) -> None:
    """A policy stands in a file of its own, under anycast of the whole configuration, or of one remote."""
    (tmp_path / "policy.yaml").write_text(LISTING)
    remote = group(listing())
    obj: object = [remote]
    if place == "file":
        obj = [remote | {"anycast": "policy.yaml"}]
    elif place == "everywhere":
        del remote["anycast"]
        obj = {"anycast": "policy.yaml", "remotes": [remote]}
    made = config.parse(obj, directory=tmp_path)
    assert made.remotes[0].anycast == config.parse([group(listing())]).remotes[0].anycast
    assert config.parse(made.to_json()).remotes == made.remotes


def test_machines_by_name() -> None:
    """Machines are the addresses in their order, or as they are named; own states and parameters of states are kept."""
    states = {"training": {"params": {"/gpu": {"watts": 90}}}, "service": {"params": [{"/gpu": ["a:=1", "b:=x"]}]}}
    policy = {"turtlebot": "robot", "one": "training", "two": "service"}
    anycast = {"state_definition": states, "initial_policy": policy, "machines": {"two": EDGE, "one": CLOUD}}
    made = config.parse([group(anycast)])
    policies = policies_of(made.remotes[0], "whoever")
    assert policies.initial == {EDGE: "service", CLOUD: "training"}
    assert policies.states["training"].params == {"/gpu": {"watts": 90}}
    assert policies.states["service"].params == {"/gpu": {"a": 1, "b": "x"}}


@pytest.mark.parametrize(
    ("changes", "path", "words"),
    [
        ({"initial_polcy": {}}, "initial_polcy", 'did you mean "initial_policy"?'),
        (
            {"initial_policy": {"t": "robot", "a": "servicee", "b": "standby"}},
            "initial_policy.a",
            'did you mean "service"?',
        ),
        ({"initial_policy": {"t": "robot", "a": "service"}}, "initial_policy", "there are 2 addresses"),
        ({"initial_policy": {"t": "robot", "a": "service", "b": "service"}}, "initial_policy.b", "write standby"),
        ({"initial_policy": {"t": "robot", "a": "robot", "b": "service"}}, "initial_policy.a", "one robot, t"),
        ({"initial_policy": ["t"]}, "initial_policy", "expected an object"),
        ({"machines": {"a": "ws://edgee"}}, "machines.a", 'did you mean "ws://edge:9090"?'),
        ({"latency_bound": {"medain": 0.3}}, "latency_bound.medain", 'did you mean "median"?'),
        ({"latency_bound": {"median": "0.3"}}, "latency_bound.median", "above 0"),
        ({"params": [{"/camera": "fps=30"}]}, 'params[0]["/camera"]', 'expected "parameter:=value"'),
        ({"params": ["/camera"]}, "params[0]", "expected an object"),
        ({"params": {"/camera": {"fps": None}}}, 'params["/camera"].fps', "expected a value"),
        ({"params": {"/camera": ["fps:=1", "fps:=2"]}}, 'params["/camera"]', "twice"),
        ({"params": {"a b": "fps:=1"}}, 'params["a b"]', "expected the name of a node"),
        ({"state_definition": {"robot": {"topcs": []}}}, "state_definition.robot.topcs", 'did you mean "topics"?'),
        (
            {"state_definition": {"robot": {"topics": [{"/yolo/input": "pbu"}]}}},
            'state_definition.robot.topics[0]["/yolo/input"]',
            'did you mean "pub"?',
        ),
        (
            {"state_definition": {"robot": {"topics": [{"/yolo/inptu": "pub"}]}}},
            "state_definition.robot.topics",
            'did you mean "/yolo/input"?',
        ),
        ({"state_definition": {"robot": {"topics": 5}}}, "state_definition.robot.topics", "expected a list"),
        (
            {"state_definition": {"robot": {"topics": [{"/a": "pub"}, {"a": "sub"}]}}},
            "state_definition.robot.topics[1].a",
            "twice",
        ),
        ({"state_definition": {"robot": []}}, "state_definition.robot", "expected an object"),
        (
            {"state_definition": {"inital_policy": {"t": "robot"}}},
            "state_definition.inital_policy",
            'did you mean "initial_policy"?',
        ),
        (
            {"state_definition": {"latency_bounds": {"median": 1}}},
            "state_definition.latency_bounds",
            'did you mean "latency_bound"?',
        ),
        ({"policy": "hegde", "stateless": True}, "policy", 'expected one of one, hedge, all, got "hegde"; did you'),
        ({"action_latency": "results"}, "action_latency", 'did you mean "result"?'),
        ({"latency_topic": "not a topic"}, "latency_topic", "expected the name of a topic"),
        ({"pause_s": -1}, "pause_s", "a number from 0"),
    ],
)
def test_mistakes(changes: dict[str, Any], path: str, words: str) -> None:
    """A mistake in a policy is told with its path and the nearest key, state, topic or address."""
    base = {"latency_bound": {"median": 0.3}}
    found = problems([group(base | changes)])
    assert words in found[f"remotes[0].anycast.{path}"]


def test_twice() -> None:
    """What stands both below and beside the states is refused."""
    found = problems([group(listing(latency_bound={"max": 1}))])
    assert "keep one" in found["remotes[0].anycast.latency_bound"]


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    """A policy file that is missing, malformed or no object is told with its name and place."""
    (tmp_path / "bad.yaml").write_text("a: [")
    (tmp_path / "list.yaml").write_text("- 1")
    missing = problems([group("missing.yaml")], tmp_path)["remotes[0].anycast"]
    assert missing == "missing.yaml: cannot be read: No such file or directory"
    assert "bad.yaml: line" in problems([group("bad.yaml")], tmp_path)["remotes[0].anycast"]
    assert "list.yaml: expected an object" in problems([group("list.yaml")], tmp_path)["remotes[0].anycast"]


def test_no_group() -> None:
    """A policy for all groups is refused where no remote is one."""
    remote = {"address": EDGE, **CROSSING}
    assert "several addresses" in problems({"anycast": {}, "remotes": [remote]})["anycast"]


def test_mistakes_of_all_groups() -> None:
    """A mistake in the policy of all groups is told once, with its own path."""
    remote = {"address": [EDGE, CLOUD], **CROSSING}
    other = {"address": ["ws://c", "ws://d"], **CROSSING}
    found = problems({"anycast": {"initial_policy": {"a": "servicee"}}, "remotes": [remote, other]})
    assert 'did you mean "service"?' in found["anycast.initial_policy.a"]


def test_no_bound() -> None:
    """What has no bound is not bounded."""
    made = config.parse([group(listing(state_definition={}))])
    anycast = made.remotes[0].anycast
    assert anycast is not None and anycast.latency_bound.limit_s is None and anycast.pairs == {}
