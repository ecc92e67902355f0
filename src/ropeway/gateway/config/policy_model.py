"""Models the states of the machines of a group, as Listing 1 of FogROS2-LS writes them (Chen 2024, chapter 4).

A state names topics, each with ``pub`` or ``sub`` as its machine sees them, and parameters of nodes, which are set when
a machine enters it. ``standby`` may be empty. In the listing ``params``, ``initial_policy`` and ``latency_bound`` stand
beside the states, at their depth; there they are taken, too.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, Final, Literal

from pydantic import BeforeValidator, Field, PlainSerializer, PlainValidator, WithJsonSchema

from ropeway.errors import InvalidName
from ropeway.gateway.config.fields import Model, below
from ropeway.gateway.config.suggest import did_you_mean, one_of, show
from ropeway.graph.base import resolve_name
from ropeway.graph.parameters import ParameterValue, parse_value

__all__ = ["LIFTED", "ROBOT", "SERVICE", "STANDBY", "Parameters", "StateConfig", "States", "lift"]

ROBOT: Final = "robot"
SERVICE: Final = "service"
STANDBY: Final = "standby"
LIFTED: Final = ("params", "initial_policy", "latency_bound")
"""Keys that may stand beside the states, as they do in the listing."""

_DIRECTIONS: Final = ("pub", "sub")
_ASSIGNS: Final = ":="
_Pairs = list[tuple[tuple[str | int, ...], str, Any]]


def lift(value: object) -> object:
    """Return an ``anycast`` object with what stands beside its states put beside ``state_definition`` itself."""
    states = value.get("state_definition") if isinstance(value, Mapping) else None
    if not isinstance(value, Mapping) or not isinstance(states, Mapping):
        return value
    for key, state in states.items():
        near = "" if key in LIFTED or _is_state(state) else did_you_mean(key, LIFTED)
        if near:
            raise below(("state_definition", str(key)), f"neither a state nor a key that may stand beside them{near}")
    lifted = {key: states[key] for key in LIFTED if key in states}
    for key in lifted:
        if key in value:
            raise below((key,), f"stands under state_definition, too; keep one of the two {key}")
    return {**value, "state_definition": {k: v for k, v in states.items() if k not in lifted}, **lifted}


def _is_state(value: object) -> bool:
    """Return whether a value is empty, or has a key of a state, so that a mistake in it is one of a state."""
    return not value or (isinstance(value, Mapping) and not value.keys().isdisjoint(StateConfig.model_fields))


def _pairs(value: object, what: str) -> _Pairs:
    """Return ``(path, name, value)`` of a list of objects with one key each, or of one object."""
    if isinstance(value, Mapping):
        return [((str(name),), str(name), item) for name, item in value.items()]
    if not isinstance(value, list | tuple):
        raise ValueError(f"expected a list such as {what}, got {show(value)}")
    found: _Pairs = []
    for at, item in enumerate(value):
        if not isinstance(item, Mapping) or not item:
            raise below((at,), f"expected an object such as {what}, got {show(item)}")
        found += [((at, str(name)), str(name), inner) for name, inner in item.items()]
    return found


def _name(path: tuple[str | int, ...], name: str, kind: str) -> str:
    try:
        return resolve_name(name)
    except InvalidName as error:
        raise below(path, f"expected the name of a {kind}: {error.reason}") from None


def _topics(value: object) -> dict[str, str]:
    found: dict[str, str] = {}
    for path, name, direction in _pairs(value, '{"/yolo/input": "sub"}') if value is not None else ():
        topic = _name(path, name, "topic")
        if direction not in _DIRECTIONS:
            raise below(path, one_of(direction, _DIRECTIONS))
        if topic in found:
            raise below(path, f"{topic} stands twice in this state; keep one")
        found[topic] = str(direction)
    return found


def _params(value: object) -> dict[str, dict[str, ParameterValue]]:
    found: dict[str, dict[str, ParameterValue]] = {}
    for path, name, given in _pairs(value, '{"/camera": "fps:=30"}') if value is not None else ():
        node = _name(path, name, "node")
        for parameter, parsed in _values(path, given):
            if parameter in found.setdefault(node, {}):
                raise below(path, f"sets {parameter} of {node} twice; keep one")
            found[node][parameter] = parsed
    return found


def _values(path: tuple[str | int, ...], given: object) -> list[tuple[str, ParameterValue]]:
    if isinstance(given, Mapping):
        wrong = next((name for name, value in given.items() if not _is_value(value)), None)
        if wrong is not None:
            raise below((*path, str(wrong)), f"expected a value of a parameter, got {show(given[wrong])}")
        return [(str(name), value) for name, value in given.items()]
    texts = given if isinstance(given, list | tuple) else [given]
    found = []
    for text in texts:
        name, assigns, value = text.partition(_ASSIGNS) if isinstance(text, str) else ("", "", "")
        if not assigns or not name.strip():
            raise below(path, f'expected "parameter{_ASSIGNS}value", got {show(text)}')
        found.append((name.strip(), parse_value(value.strip())))
    return found


def _is_value(value: object) -> bool:
    if isinstance(value, list):
        return all(isinstance(item, bool | int | float | str) for item in value)
    return isinstance(value, bool | int | float | str)


def _empty(value: object) -> object:
    return {} if value is None else value


_PARAMETER_LIST: Final[dict[str, Any]] = {
    "anyOf": [
        {"type": "array", "items": {"type": "object", "additionalProperties": {"type": ["string", "array", "object"]}}},
        {"type": "object", "additionalProperties": {"type": ["string", "array", "object"]}},
        {"type": "null"},
    ]
}
_TOPIC_DIRECTION: Final[dict[str, Any]] = {"type": "object", "additionalProperties": {"enum": list(_DIRECTIONS)}}

Parameters = Annotated[
    dict[str, dict[str, ParameterValue]],
    PlainValidator(_params),
    PlainSerializer(lambda found: found),
    WithJsonSchema(_PARAMETER_LIST),
]
"""Parameters by node, as ``[{"/camera": "rgb_module.profile:=640x480x30"}]`` or ``{"/camera": {"fps": 30}}``."""


class StateConfig(Model):
    """Describes a state of a machine."""

    topics: Annotated[
        dict[str, Literal["pub", "sub"]],
        PlainValidator(_topics),
        WithJsonSchema(
            {"anyOf": [{"type": "array", "items": _TOPIC_DIRECTION}, _TOPIC_DIRECTION, {"type": "null"}]},
        ),
    ] = Field({}, description="topics that a machine in this state publishes (pub) or reads (sub)")
    params: Parameters = Field({}, description="parameters of its nodes that are set when it enters the state")


States = dict[str, Annotated[StateConfig, BeforeValidator(_empty)]]
"""States by name; an empty one has no topics and no parameters."""
