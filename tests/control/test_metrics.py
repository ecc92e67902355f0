"""Metrics for Prometheus, and what is made of them."""

from __future__ import annotations

import hashlib
import json
import re
from pathlib import Path
from typing import Any

import pytest
import yaml
from prometheus_client import Metric
from prometheus_client.openmetrics.parser import text_string_to_metric_families as read_openmetrics
from prometheus_client.parser import text_string_to_metric_families

from ropeway.control.client import find_target
from ropeway.control.metrics import Metrics
from ropeway.delivery.histogram import BOUNDS_S
from ropeway.gateway.config.check import check
from ropeway.gateway.config.config import parse
from ropeway.gateway.process.supervisor import Supervisor
from tests.control.conftest import Begin

DEPLOY = Path(__file__).parents[2] / "deploy"
ROUTE = {"operation": "publish", "name": "/odom", "address": "ws://cloud:9090"}
STATUS: dict[str, Any] = {
    "name": "robot1",
    "routes": [
        {
            **ROUTE,
            "key": "publish-odom",
            "remote_name": "/odom",
            "state": "active",
            "messages": 7,
            "bytes": 700,
            "publishers": 1,
            "readers": None,
            "delay_ms": 25.0,
            "drops": {"older than its lifespan": 3},
            "delays": {"counts": [1, 0, 5, *[0] * 8, 1], "sum_s": 9.5},
        },
        {
            **ROUTE,
            "operation": "reserve-service",
            "key": "reserve-odom",
            "remote_name": "/odom",
            "state": "waiting",
            "requests": 2,
            "under_way": 1,
            "took_ms": 4.0,
            "ended": {"answered": 1},
            "durations": {"counts": [2, *[0] * 11], "sum_s": 0.001},
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
        {
            "graph": "dds:0",
            "topics": 4,
            "nodes": 2,
            "duplicates": 1,
            "drops": {"/a: the network refused it": 5},
            "client_delays": {"published": {"/odom": {"counts": [2, *[0] * 11], "sum_s": 0.001}}, "read": {}},
        }
    ],
    "sessions": [{"dialect": "rosbridge", "role": "all"}] * 2,
    "access": {"refused": {"wrong token": 4}, "denied": {"publish": 6}},
    "memory": {"held_bytes": 100, "limit_bytes": 1000},
    "codecs": {
        "encode": {"zstd": {"counts": [3, *[0] * 11], "sum_s": 0.002}},
        "decode": {"none": {"counts": [1, *[0] * 11], "sum_s": 0.001}},
    },
    "failed": ["a task"],
}
OPENMETRICS = "application/openmetrics-text;version=1.0.0"


def read(body: bytes, media_type: str) -> list[Metric]:
    """Return what a reader of the format finds."""
    parse = (
        read_openmetrics if media_type.startswith("application/openmetrics-text") else text_string_to_metric_families
    )
    return list(parse(body.decode()))


def values(accept: str = "") -> dict[str, float]:
    """Return every sample of a status by its name and labels."""
    families = read(*Metrics(lambda: STATUS).text(accept))
    return {
        f"{sample.name}{sorted(sample.labels.items())}": sample.value
        for family in families
        for sample in family.samples
    }


@pytest.mark.parametrize("accept", ["", OPENMETRICS])
def test_every_figure_is_there(accept: str) -> None:
    """Counters, gauges and histograms have the figures of the status, in base units, in both formats."""
    found = values(accept)
    route = sorted(ROUTE.items())
    assert found[f"ropeway_route_messages_total{route}"] == 7
    assert found[f"ropeway_route_delay_seconds{route}"] == 0.025
    assert f"ropeway_route_readers{route}" not in found
    assert found[f"ropeway_route_drops_total{sorted({**ROUTE, 'reason': 'older than its lifespan'}.items())}"] == 3
    assert found["ropeway_link_round_trip_seconds[('address', 'ws://cloud:9090')]"] == 0.07
    assert found["ropeway_sessions[('dialect', 'rosbridge'), ('role', 'all')]"] == 2
    assert found["ropeway_failed_tasks[]"] == 1
    client = sorted({"graph": "dds:0", "direction": "published", "topic": "/odom"}.items())
    assert found[f"ropeway_client_message_delay_seconds_count{client}"] == 2
    delay = "ropeway_route_message_delay_seconds"
    assert found[f"{delay}_count{route}"] == 7
    assert found[f"{delay}_sum{route}"] == 9.5
    assert found[f"{delay}_bucket{sorted({**ROUTE, 'le': '0.005'}.items())}"] == 6
    assert found[f"ropeway_encode_seconds_count{[('encoding', 'zstd')]}"] == 3
    called = sorted({**ROUTE, "operation": "reserve-service"}.items())
    assert found[f"ropeway_route_request_duration_seconds_count{called}"] == 2


@pytest.mark.parametrize("accept", ["", OPENMETRICS])
def test_every_metric_has_a_help_text_and_a_unit(accept: str) -> None:
    """Each metric has a help text, and durations and sizes have their unit in their name."""
    body, media_type = Metrics(lambda: STATUS).text(accept)
    for family in read(body, media_type):
        assert family.documentation, family.name
        if family.type == "histogram":
            assert family.name.endswith("_seconds")


def test_what_changes_is_written_anew() -> None:
    """A second scrape has the state and the counts of its time, and routes that are gone have no lines."""
    route = {**STATUS["routes"][0], "remote_name": '/there "quoted"\n'}
    status = {**STATUS, "routes": [route]}
    metrics = Metrics(lambda: status)
    before = metrics.text()[0].decode()
    assert r'remote_name="/there \"quoted\"\n"' in before
    status["routes"] = [route | {"state": "failed", "delays": {"counts": [1] * 12, "sum_s": 1.0}}]
    after = {sample.name: sample for family in read(*metrics.text()) for sample in family.samples if sample.value}
    assert after["ropeway_route_state"].labels["ropeway_route_state"] == "failed"
    assert after["ropeway_route_message_delay_seconds_count"].value == len(BOUNDS_S) + 1
    status["routes"] = []
    assert "ropeway_route_messages_total{" not in metrics.text()[0].decode()


def test_routes_of_the_same_labels_are_one() -> None:
    """Of two routes that differ in their type alone the first has the lines, since a series stands once."""
    first = STATUS["routes"][0]
    status = {**STATUS, "routes": [first, first | {"key": "another type", "messages": 8}]}
    metrics = Metrics(lambda: status)

    def told() -> list[str]:
        text = metrics.text()[0].decode()
        return [line[-2:] for line in text.splitlines() if line.startswith("ropeway_route_messages_total{")]

    assert told() == [" 7"]
    status["routes"] = status["routes"][::-1]
    assert told() == [" 8"]


@pytest.mark.parametrize(
    "accept",
    ["application/openmetrics-text;version=x", "text/plain;version=", "text/plain;version=9.x", "," * 999, "*"],
)
def test_what_is_asked_for_strangely(accept: str) -> None:
    """A header that names no version that there is gets a format that can be read."""
    assert read(*Metrics(lambda: STATUS).text(accept))


async def test_a_listener_of_its_own(begin: Begin) -> None:
    """Where asked, an address over TCP has metrics and nothing else, for who may observe."""
    token = hashlib.sha256(b"scraper").hexdigest()
    auth = {
        "tokens": [{"hash": f"sha256:{token}", "role": "watcher"}],
        "roles": {"watcher": {"control": ["observe", "configure", "operate"]}},
    }
    made = await begin(control={"metrics": ["http://127.0.0.1:0"]}, auth=auth)
    (address,) = made.control.metrics_addresses
    async with find_target(address, token="scraper").async_client() as scraper:
        answer = await scraper.get("/metrics")
        assert answer.status_code == 200
        assert "ropeway_gateway_info" in answer.text
        for path in ("/v1/status", "/v1/config", "/openapi.json"):
            assert (await scraper.get(path)).status_code == 404
    async with find_target(address).async_client() as nobody:
        assert (await nobody.get("/metrics")).status_code == 401


def test_a_listener_without_authentication_is_a_fault() -> None:
    """Metrics over TCP need tokens or certificates, and https a certificate of ours."""
    _, problems = check({"gateway": {"control": {"metrics": ["https://0.0.0.0:9464"]}}}, Path())
    assert [path for path, _ in problems] == ["gateway.control.metrics"] * 2


async def test_with_workers() -> None:
    """A supervisor's status has what the metrics of a gateway have, added up."""
    document = {"gateway": {"name": "w", "graphs": ["memory:w"], "listen": [], "workers": 2}, "remotes": []}
    supervisor = Supervisor(parse(document))
    for worker in supervisor.workers:
        worker.status = json.loads(json.dumps(STATUS | {"memory": {**STATUS["memory"], "ended": {"too much": 1}}}))
    body, _ = Metrics(supervisor.status).text()
    found = body.decode()
    assert "ropeway_connections_held_bytes 200.0" in found
    assert 'ropeway_graph_topics{graph="dds:0"} 4.0' in found
    assert 'ropeway_graph_duplicates_total{graph="dds:0"} 2.0' in found
    assert 'ropeway_client_message_delay_seconds_count{direction="published",graph="dds:0",topic="/odom"} 4.0' in found
    assert 'ropeway_encode_seconds_count{encoding="zstd"} 6.0' in found
    assert supervisor.status()["memory"]["ended"] == {"too much": 2}


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
    asked = set(re.findall(r"(?:ropeway|process)_\w+(?=[{\[)]|$| )", expression))
    assert asked
    assert asked <= names
    grouped = re.findall(r"by \(([^)]*)\)", expression)
    used = {word.strip() for group in grouped for word in group.split(",")}
    used |= set(re.findall(r"[{,]\s*(\w+)\s*!?=", expression))
    assert used <= labels
