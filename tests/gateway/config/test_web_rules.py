"""Rules of the original gateway for web servers are taken as they are written there, or what is not known is said."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config.config import parse

STRING = "std_msgs/msg/String"


def _rule(**more: Any) -> dict[str, Any]:
    return {
        "service_name": "detect",
        "service_uri": "http://127.0.0.1:8000/detect",
        "service_method": "POST",
        "request_rule": {
            "content-type": "application/json; charset=utf-8",
            "topics": {"/image": STRING},
            "mapping": [{"in": "/image", "from": "", "out": "#body", "to": ""}],
        },
        "response_rule": {"content-type": "application/json", "topics": {"/found": STRING}},
        **more,
    }


def test_a_rule_among_remotes() -> None:
    """A rule is one of gateway.http, and the remotes beside it keep their order."""
    remotes = [{"address": "ws://a"}, {"address": "ws://b"}]
    config = parse([remotes[0], _rule(), remotes[1], _rule(active=False)])
    [rule] = config.gateway.http
    assert (rule.url, rule.topic, rule.type) == ("http://127.0.0.1:8000/detect", "/image", STRING)
    assert rule.answer is not None
    assert (rule.answer.topic, rule.answer.type) == ("/found", STRING)
    assert [remote.address for remote in config.remotes] == ["ws://a:9090", "ws://b:9090"]


def test_fields_files_and_headers() -> None:
    """The mappings of a rule become fields, files and headers, and whole messages no fields at all."""
    image = "sensor_msgs/msg/CompressedImage"
    mapping = [
        {"in": "/image", "from": "header/frame_id", "out": "#body", "to": "camera"},
        {"in": "#const", "from": "fast", "out": "#body", "to": "mode"},
        {"in": "/image", "from": "#value", "out": "#files", "to": "picture"},
    ]
    answered = [
        {"in": "#body", "from": "results[0].label", "out": "/found", "to": "data"},
        {"in": "/image", "from": "header", "out": "/found", "to": "header"},
    ]
    request = {"content-type": "multipart/form-data", "headers": {"x-team": "${TEAM}"}, "topics": {"/image": image}}
    response = {"content-type": "application/json", "topics": {"/found": STRING}, "mapping": answered}
    [rule] = parse([_rule(request_rule={**request, "mapping": mapping}, response_rule=response)]).gateway.http
    assert [(field.source, field.value, field.to) for field in rule.fields] == [
        ("header/frame_id", None, "camera"),
        (None, "fast", "mode"),
    ]
    assert [(file.source, file.name) for file in rule.files] == [("", "picture")]
    assert rule.headers == {"x-team": "${TEAM}"}
    assert rule.answer is not None
    assert [(field.of, field.source, field.to) for field in rule.answer.fields] == [
        ("answer", "results[0].label", "data"),
        ("message", "header", "header"),
    ]
    [form] = parse([_rule(request_rule=request)]).gateway.http
    assert [(file.source, file.name) for file in form.files] == [("", "file")]


def test_a_rule_alone() -> None:
    """A file with one rule and nothing else is a configuration."""
    assert len(parse(_rule()).gateway.http) == 1


@pytest.mark.parametrize(
    ("more", "path"),
    [
        ({"service_method": "GET"}, "[1].service_method"),
        ({"request_rule": {"topics": {}}}, "[1].request_rule.topics"),
        ({"request_rule": []}, "[1].request_rule"),
        ({"request_rule": {"topics": {"/a": STRING, "/b": STRING}}}, "[1].request_rule.topics"),
        (
            {"request_rule": {"topics": {"/a": STRING}, "content-type": "text/plain"}},
            "[1].request_rule.content-type",
        ),
        ({"request_rule": {"topics": {"/a": STRING}, "headers": ["a"]}}, "[1].request_rule.headers"),
        ({"response_rule": {"topics": {}, "headers": {"a": "b"}}}, "[1].response_rule.headers"),
        ({"request_rule": {"topics": {"/a": STRING}, "mapping": ["x"]}}, "[1].request_rule.mapping[0]"),
        ({"request_rule": {"topics": {"/a": STRING}, "mapping": {"x": 1}}}, "[1].request_rule.mapping"),
        (
            {"request_rule": {"topics": {"/a": STRING}, "mapping": [{"in": "/b", "from": "x", "to": "y"}]}},
            "[1].request_rule.mapping[0].in",
        ),
        (
            {"request_rule": {"topics": {"/a": STRING}, "mapping": [{"in": "#const", "out": "#files", "to": "y"}]}},
            "[1].request_rule.mapping[0].in",
        ),
        (
            {
                "request_rule": {
                    "topics": {"/a": STRING},
                    "content-type": "multipart/form-data",
                    "mapping": [{"from": "data", "to": "text"}],
                }
            },
            "[1].request_rule.mapping",
        ),
        (
            {"response_rule": {"topics": {"/a": STRING}, "mapping": [{"from": "x", "out": "#body", "to": "data"}]}},
            "[1].response_rule.mapping[0].out",
        ),
        (
            {"response_rule": {"topics": {"/a": STRING}, "mapping": [{"form": "x", "to": "data"}]}},
            "[1].response_rule.mapping[0].form",
        ),
        ({"servce_name": "x"}, "[1].servce_name"),
    ],
)
def test_what_is_not_known_is_said(more: dict[str, Any], path: str) -> None:
    """What such a rule may have in the original and not here is refused with its place."""
    with pytest.raises(ConfigError) as caught:
        parse([{"address": "ws://a"}, _rule(**more)])
    assert [where for where, _ in caught.value.problems] == [path]
