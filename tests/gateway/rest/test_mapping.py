"""Requests to web servers, and messages of their answers, are made as a rule says."""

from __future__ import annotations

import base64
from typing import Any

import orjson
import pytest

from ropeway.errors import ConfigError, ConversionError, RopewayError
from ropeway.gateway.config.http_model import HttpRule
from ropeway.gateway.rest.mapping import AnswerMapping, Posted, RequestMapping
from ropeway.types import TypeRegistry

REGISTRY = TypeRegistry()
COMPRESSED = "sensor_msgs/msg/CompressedImage"
IMAGE = "sensor_msgs/msg/Image"
STAMPED = "geometry_msgs/msg/PointStamped"
JPEG = {"header": {"frame_id": "camera"}, "format": "rgb8; jpeg compressed bgr8", "data": b"\xff\xd8"}


def posted(type: str, message: dict[str, Any], **rule: Any) -> Posted:
    made = HttpRule.model_validate({"url": "http://a/", "topic": "/a", "type": type, **rule})
    return RequestMapping(made, type, REGISTRY, "http").make(REGISTRY.codec(type).encode(message))


def answered(type: str, answer: bytes, media_type: str = "application/json", **rule: Any) -> dict[str, Any]:
    made = HttpRule.model_validate(
        {"url": "http://a/", "topic": "/a", "type": STAMPED, "answer": {"topic": "/b", "type": type, **rule}}
    )
    assert made.answer is not None
    sent = posted(STAMPED, {"header": {"frame_id": "map"}})
    payload = AnswerMapping(made.answer, type, REGISTRY, "http").make(answer, media_type, sent.message)
    return REGISTRY.codec(type).decode(payload)


def test_fields_of_a_message(monkeypatch: pytest.MonkeyPatch) -> None:
    """Fields and constants go to their places in the body; a variable of the environment is looked up."""
    monkeypatch.setenv("MODE", "fast")
    fields = [
        {"from": "header/frame_id", "to": "camera.name"},
        {"from": "", "to": "image"},
        {"value": "very ${MODE}", "to": "options[]"},
        {"value": 3, "to": "options[]"},
    ]
    made = posted(COMPRESSED, JPEG, fields=fields)
    assert orjson.loads(made.arguments["content"]) == {
        "camera": {"name": "camera"},
        "image": base64.b64encode(b"\xff\xd8").decode(),
        "options": ["very fast", 3],
    }


def test_a_picture_is_a_file() -> None:
    """A compressed image goes as the file that it is, an image as PNG, and fields beside them as those of a form."""
    made = posted(
        COMPRESSED, JPEG, files=[{}], fields=[{"value": {"a": 1}, "to": "more"}, {"value": "b", "to": "text"}]
    )
    assert made.arguments == {
        "data": {"more": '{"a":1}', "text": "b"},
        "files": [("file", ("file.jpg", b"\xff\xd8", "image/jpeg"))],
    }
    raw = {"width": 1, "height": 1, "step": 3, "encoding": "rgb8", "data": b"abc"}
    [(name, (file, data, kind))] = posted(IMAGE, raw, files=[{"from": "data", "name": "x"}]).arguments["files"]
    assert (name, file, kind, data[:4]) == ("x", "x.png", "image/png", b"\x89PNG")


def test_bytes_are_a_file() -> None:
    """A field of bytes goes as a file, too."""
    made = posted("std_msgs/msg/ByteMultiArray", {"data": [b"a"]}, files=[{"from": "data"}])
    assert made.arguments["files"][0][1][0] == "file.bin"


@pytest.mark.parametrize(
    ("type", "rule"),
    [
        (STAMPED, {"fields": [{"from": "header/nothing", "to": "x"}]}),
        (STAMPED, {"fields": [{"from": "header", "to": ""}, {"from": "point", "to": "[4]"}]}),
        (STAMPED, {"files": [{}]}),
        (STAMPED, {"files": [{"from": "point"}]}),
        (IMAGE, {"files": [{}]}),
        (COMPRESSED, {"files": [{}], "fields": [{"value": "x", "to": ""}]}),
    ],
)
def test_what_a_message_has_not(type: str, rule: dict[str, Any]) -> None:
    """A message that has not what the rule wants is an error with the place."""
    with pytest.raises(ConversionError):
        posted(type, {}, **rule)


def test_a_message_of_an_answer() -> None:
    """Fields of the answer, of the message that was posted and constants make the message that is published."""
    fields = [
        {"from": "results[0].x", "to": "point.x"},
        {"of": "message", "from": "header/frame_id", "to": "header.frame_id"},
        {"value": 2.5, "to": "point.y"},
    ]
    found = answered(STAMPED, b'{"results": [{"x": 1.5}]}', fields=fields)
    assert (found["point"]["x"], found["point"]["y"], found["header"]["frame_id"]) == (1.5, 2.5, "map")


def test_a_picture_of_an_answer() -> None:
    """A picture becomes a compressed image of its format."""
    found = answered(COMPRESSED, b"\x89PNG", "image/png; q=1")
    assert (found["format"], bytes(found["data"])) == ("png", b"\x89PNG")


@pytest.mark.parametrize(
    ("answer", "media_type", "fields"),
    [
        (b"<html>", "text/html", []),
        (b"{}", "application/json", [{"from": "x", "to": "point.x"}]),
        (b'{"x": "text"}', "application/json", [{"from": "x", "to": "point.x"}]),
        (b'{"x": 1}', "application/json", [{"from": "x", "to": "point"}, {"from": "x", "to": "point.x"}]),
        (b"\x89PNG", "image/png", []),
    ],
)
def test_an_answer_that_does_not_fit(answer: bytes, media_type: str, fields: list[Any]) -> None:
    """An answer that has not what the rule wants, or of another kind, is an error."""
    with pytest.raises(RopewayError):
        answered(STAMPED, answer, media_type, fields=fields)


def test_a_variable_that_is_not_set(monkeypatch: pytest.MonkeyPatch) -> None:
    """A variable that is not set is a fault of the configuration, with its place."""
    monkeypatch.delenv("MODE", raising=False)
    with pytest.raises(ConfigError) as caught:
        posted(STAMPED, {}, fields=[{"value": "${MODE}", "to": "x"}])
    assert caught.value.problems == [("http.fields[0].value", "the environment variable MODE is not set")]


@pytest.mark.parametrize(
    "rule",
    [
        {"fields": [{"from": "a..b", "to": "x"}]},
        {"fields": [{"to": "x"}]},
        {"fields": [{"from": "a", "value": 1, "to": "x"}]},
        {"headers": {"content-length": "1"}},
        {"headers": {"a b": "1"}},
        {"headers": {"a": "1\r\nb: 2"}},
        {"headers": {"Authorization": "Bearer x"}},
        {"topic": None, "service": "/s", "files": [{}]},
    ],
)
def test_a_rule_that_is_none(rule: dict[str, Any]) -> None:
    """Paths, headers and steps are checked, and a secret goes over https:// alone."""
    with pytest.raises(ValueError, match="validation error"):
        HttpRule.model_validate({"url": "http://a/", "topic": "/a", "type": STAMPED, **rule})
