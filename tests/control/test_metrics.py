"""Metrics for Prometheus, and what is made of them."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml
from prometheus_client import CollectorRegistry
from prometheus_client.parser import text_string_to_metric_families

from ropeway.control.metrics import StatusCollector
from tests.control.conftest import Begin

DEPLOY = Path(__file__).parents[2] / "deploy"
ROUTE = {"operation": "publish", "name": "/odom", "address": "ws://cloud:9090"}
STATUS = {
    "name": "robot1",
    "routes": [
        {
            **ROUTE,
            "state": "active",
            "messages": 7,
            "bytes": 700,
            "publishers": 1,
            "readers": None,
            "delay_ms": 25.0,
            "drops": {"older than its lifespan": 3},
        },
        {
            **ROUTE,
            "operation": "reserve-service",
            "state": "waiting",
            "requests": 2,
            "under_way": 1,
            "took_ms": 4.0,
            "ended": {"answered": 1},
        },
    ],
    "remotes": [
        {
            "address": "ws://cloud:9090",
            "state": "connected",
            "connections": 2,
            "bytes_in": 10,
            "bytes_out": 20,
            "rtt_ms": 70.0,
            "pace_bps": 5_000_000,
        },
        {"address": "ws://a,ws://b", "state": "connected", "members": [{"address": "ws://a", "state": "closed"}]},
    ],
    "graphs": [
        {"graph": "dds:0", "topics": 4, "nodes": 2, "duplicates": 1, "drops": {"/a: the network refused it": 5}}
    ],
    "sessions": [{"dialect": "rosbridge", "role": "all"}] * 2,
    "access": {"refused": {"wrong token": 4}, "denied": {"publish": 6}},
    "memory": {"held_bytes": 100, "limit_bytes": 1000},
    "failed": ["a task"],
}


def values() -> dict[str, float]:
    """Return every sample of a status by its name and labels."""
    registry = CollectorRegistry()
    registry.register(StatusCollector(lambda: STATUS))
    return {
        f"{sample.name}{sorted(sample.labels.items())}": sample.value
        for family in registry.collect()
        for sample in family.samples
    }


def test_every_figure_is_there() -> None:
    """Counters and gauges have the figures of the status, in base units."""
    found = values()
    route = sorted(ROUTE.items())
    assert found[f"ropeway_route_messages_total{route}"] == 7
    assert found[f"ropeway_route_delay_seconds{route}"] == 0.025
    assert f"ropeway_route_readers{route}" not in found
    assert found[f"ropeway_route_drops_total{sorted({**ROUTE, 'reason': 'older than its lifespan'}.items())}"] == 3
    assert found["ropeway_link_round_trip_seconds[('address', 'ws://cloud:9090')]"] == 0.07
    assert found["ropeway_sessions[('dialect', 'rosbridge'), ('role', 'all')]"] == 2
    assert found["ropeway_failed_tasks[]"] == 1


def test_groups_count_by_member() -> None:
    """A group has the state of each of its members."""
    assert values()["ropeway_link_state[('address', 'ws://a'), ('ropeway_link_state', 'closed')]"] == 1


async def test_over_the_control_api(begin: Begin) -> None:
    """A gateway gives its metrics as text that Prometheus reads, each with a help text."""
    running = await begin(
        [{"address": "ws://127.0.0.1:1", "publish": [{"name": "/odom", "type": "std_msgs/msg/String"}]}]
    )
    answer = await running.client.get("/metrics")
    assert answer.status_code == 200
    assert answer.headers["content-type"].startswith("text/plain")
    families = {family.name: family for family in text_string_to_metric_families(answer.text)}
    assert families["ropeway_route_messages"].samples[0].labels["name"] == "/odom"
    assert all(family.documentation for family in families.values())


def _expressions() -> list[str]:
    dashboard = json.loads((DEPLOY / "grafana" / "ropeway.json").read_text())
    rules = yaml.safe_load((DEPLOY / "prometheus" / "ropeway.rules.yaml").read_text())
    found = [target["expr"] for panel in dashboard["panels"] for target in panel["targets"]]
    return found + [rule["expr"] for group in rules["groups"] for rule in group["rules"]]


@pytest.mark.parametrize("expression", _expressions())
def test_dashboard_and_alerts_ask_for_what_there_is(expression: str) -> None:
    """Every metric and label in the dashboard and in the alert rules exists."""
    found = values()
    names = {key.partition("[")[0] for key in found}
    labels = {label for key in found for label in re.findall(r"\('(\w+)',", key)} | {"instance"}
    asked = set(re.findall(r"ropeway_\w+(?=[{\[)]|$| )", expression))
    assert asked <= names
    grouped = re.findall(r"by \(([^)]*)\)", expression)
    used = {word.strip() for group in grouped for word in group.split(",")}
    used |= set(re.findall(r"[{,]\s*(\w+)\s*!?=", expression))
    assert used <= labels
