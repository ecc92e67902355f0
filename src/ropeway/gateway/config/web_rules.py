"""Reads the rules of the original ROS Gateway for web servers, and brings them to the form of ``gateway.http``.

Such a rule stands among the remotes and has a ``service_uri``. Whole messages are posted and taken; its mappings of
single fields, forms with files, and methods other than POST are not known, and that is said.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Final

from ropeway.gateway.config.suggest import show, unknown_key

__all__ = ["with_web_rules"]

Problem = tuple[str, str]

_KEYS: Final = ("service_name", "service_uri", "service_method", "request_rule", "response_rule", "active", "title")
_SIDE_KEYS: Final = ("content-type", "headers", "topics", "mapping")
_JSON: Final = "application/json"
_WHOLE: Final = ("", "/", ".", "#value", "#body", None)


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
        kind = side.get("content-type", _JSON)
        if not isinstance(kind, str) or kind.partition(";")[0].strip() != _JSON:
            yield f"{key}.content-type", f"expected {_JSON}, got {show(kind)}"
        if side.get("headers"):
            yield f"{key}.headers", 'headers are not known; write the rule under gateway.http, with "token"'
        topics = side.get("topics", {})
        if not isinstance(topics, Mapping) or not least <= len(topics) <= 1:
            wanted = "one topic with its type" if least else "at most one topic with its type"
            yield f"{key}.topics", f"expected {wanted}, got {show(topics)}"
        mapping = side.get("mapping") or []
        if not isinstance(mapping, list) or not all(map(_is_whole, mapping)):
            yield f"{key}.mapping", "only whole messages are posted and taken; leave the mapping of fields out"


def _is_whole(step: object) -> bool:
    """Return whether a step of a mapping takes a whole message to a whole body, or the other way."""
    return isinstance(step, Mapping) and step.get("from") in _WHOLE and step.get("to") in _WHOLE


def _converted(rule: Mapping[str, Any]) -> dict[str, Any]:
    [(topic, type)] = rule["request_rule"]["topics"].items()
    found: dict[str, Any] = {"url": rule["service_uri"], "topic": topic, "type": type}
    for name, kind in rule.get("response_rule", {}).get("topics", {}).items():
        found["answer"] = {"topic": name, "type": kind}
    return found
