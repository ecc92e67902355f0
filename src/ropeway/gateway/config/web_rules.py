"""Reads the rules of the original ROS Gateway for web servers, and brings them to the form of ``gateway.http``.

Such a rule stands among the remotes and has a ``service_uri``. Rules of several topics that are posted as one, and
methods other than POST, are not known, and that is said.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from ropeway.gateway.config.suggest import show, unknown_key

__all__ = ["with_web_rules"]

Problem = tuple[str, str]

_KEYS: Final = ("service_name", "service_uri", "service_method", "request_rule", "response_rule", "active", "title")
_SIDE_KEYS: Final = ("content-type", "headers", "topics", "mapping")
_STEP_KEYS: Final = ("in", "from", "out", "to")
_JSON: Final = "application/json"
_FORM: Final = "multipart/form-data"
_WHOLE: Final = ("", "/", ".", "#value", "#body", None)
_CONSTANT: Final = "#const"
_BODY: Final = ("#body", "#context.json", None)
_FILES: Final = "#files"


def with_web_rules(document: object) -> tuple[object, list[Problem]]:
    """Return a document in which such rules stand under ``gateway.http``, and every fault of them."""
    listed = [document] if _is_rule(document) else document
    if not isinstance(listed, list) or not any(map(_is_rule, listed)):
        return document, []
    rules: list[dict[str, Any]] = []
    problems: list[Problem] = []
    for index, rule in enumerate(listed):
        if not _is_rule(rule):
            continue
        faults = list(_faults(rule))
        problems += [(f"[{index}].{path}", text) for path, text in faults]
        if not faults and rule.get("active", True) is not False:
            rules.append(_converted(rule))
    remotes = [one for one in listed if not _is_rule(one)]
    return {"gateway": {"http": rules}, "remotes": remotes}, problems


def _is_rule(value: object) -> bool:
    return isinstance(value, Mapping) and "service_uri" in value and "address" not in value


def _faults(rule: Mapping[str, Any]) -> Iterator[Problem]:
    yield from ((str(key), unknown_key(key, _KEYS)) for key in rule if key not in _KEYS)
    method = rule.get("service_method", "POST")
    if method != "POST":
        yield "service_method", f"expected POST, got {show(method)}"
    for key, least in (("request_rule", 1), ("response_rule", 0)):
        side = rule.get(key, {})
        if not isinstance(side, Mapping):
            yield key, f"expected an object, got {show(side)}"
            continue
        yield from ((f"{key}.{name}", unknown_key(name, _SIDE_KEYS)) for name in side if name not in _SIDE_KEYS)
        sent = rule.get("request_rule")
        posted = sent.get("topics") if isinstance(sent, Mapping) else None
        names = tuple(posted) if isinstance(posted, Mapping) else ()
        yield from ((f"{key}.{name}", text) for name, text in _side_faults(key, side, least, names))


def _side_faults(key: str, side: Mapping[str, Any], least: int, posted: tuple[str, ...]) -> Iterator[Problem]:
    kind = _media_type(side)
    fits = kind in (_JSON, _FORM) if key == "request_rule" else kind == _JSON or kind.startswith("image/")
    if not fits:
        wanted = f"{_JSON} or {_FORM}" if key == "request_rule" else f"{_JSON} or image/*"
        yield "content-type", f"expected {wanted}, got {show(side['content-type'])}"
    headers = side.get("headers") or {}
    if not isinstance(headers, Mapping) or (headers and key == "response_rule"):
        yield "headers", f"expected an object, of the request alone, got {show(headers)}"
    topics = side.get("topics", {})
    if not isinstance(topics, Mapping) or not least <= len(topics) <= 1:
        wanted = "one topic with its type" if least else "at most one topic with its type"
        yield "topics", f"expected {wanted}, got {show(topics)}"
        return
    mapping = side.get("mapping") or []
    if not isinstance(mapping, list):
        yield "mapping", f"expected a list, got {show(mapping)}"
        return
    for number, step in enumerate(mapping):
        sources = (*posted, None, _CONSTANT) if key == "request_rule" else (*_BODY, *posted, _CONSTANT)
        targets = (*_BODY, _FILES) if key == "request_rule" else (*topics, None)
        yield from ((f"mapping[{number}]{name}", text) for name, text in _step_faults(step, sources, targets))
    files = [step for step in mapping if isinstance(step, Mapping) and step.get("out") == _FILES]
    if kind == _FORM and mapping and not files:
        yield "mapping", f'expected a step with "out": "{_FILES}", since it is a form'


def _step_faults(step: object, sources: tuple[object, ...], targets: tuple[object, ...]) -> Iterator[Problem]:
    if not isinstance(step, Mapping):
        yield "", f"expected an object, got {show(step)}"
        return
    yield from ((f".{name}", unknown_key(name, _STEP_KEYS)) for name in step if name not in _STEP_KEYS)
    source, target = step.get("in"), step.get("out")
    if source not in sources:
        yield ".in", f"expected {_listed(sources)}, got {show(source)}"
    if target not in targets:
        yield ".out", f"expected {_listed(targets)}, got {show(target)}"
    if target == _FILES and source == _CONSTANT:
        yield ".in", "a file comes from a topic"


def _listed(words: tuple[object, ...]) -> str:
    return " or ".join(str(word) for word in words if word is not None)


def _media_type(side: Mapping[str, Any]) -> str:
    kind = side.get("content-type", _JSON)
    return kind.partition(";")[0].strip() if isinstance(kind, str) else ""


def _converted(rule: Mapping[str, Any]) -> dict[str, Any]:
    request = rule["request_rule"]
    [(topic, type)] = request["topics"].items()
    found: dict[str, Any] = {"url": rule["service_uri"], "topic": topic, "type": type}
    if headers := request.get("headers"):
        found["headers"] = dict(headers)
    steps = request.get("mapping") or []
    fields = [_field(step) for step in steps if step.get("out") != _FILES]
    files = [_file(step) for step in steps if step.get("out") == _FILES]
    if _media_type(request) == _FORM and not files:
        files = [{}]  # the picture, as the file "file"
    if not all(map(_is_whole, fields)):
        found["fields"] = fields
    if files:
        found["files"] = files
    response = rule.get("response_rule", {})
    for name, kind in response.get("topics", {}).items():
        answered = [_answered(step, topic) for step in response.get("mapping") or []]
        found["answer"] = {"topic": name, "type": kind}
        if not all(map(_is_whole, answered)) and not _media_type(response).startswith("image/"):
            found["answer"]["fields"] = answered
    return found


def _is_whole(field: Mapping[str, Any]) -> bool:
    """Return whether a step takes a whole message to a whole body, or the other way."""
    return field.get("from") == "" and field["to"] == "" and field.get("of") != "message"


def _path(text: object) -> object:
    return "" if text in _WHOLE else text


def _field(step: Mapping[str, Any]) -> dict[str, Any]:
    if step.get("in") == _CONSTANT:
        return {"value": step.get("from"), "to": _path(step.get("to"))}
    return {"from": _path(step.get("from")), "to": _path(step.get("to"))}


def _answered(step: Mapping[str, Any], topic: str) -> dict[str, Any]:
    return {**_field(step), **({"of": "message"} if step.get("in") == topic else {})}


def _file(step: Mapping[str, Any]) -> dict[str, Any]:
    return {"from": _path(step.get("from")), "name": _path(step.get("to")) or "file"}
