"""rosbridge's parameters that mean nothing here, and its ways to write those that do."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, Final

from ropeway.cli.server.foxglove import FOXGLOVE_NODE, UNUSED
from ropeway.cli.server.rosargs import split
from ropeway.errors import ConfigError

__all__ = ["NODE", "WITHOUT_EFFECT", "arguments", "notes"]

NODE: Final = "rosbridge_websocket"
"""The name of rosbridge's node, and of ours unless it is told another."""

WITHOUT_EFFECT: Final[Mapping[str, tuple[tuple[str, ...], str]]] = {
    "incoming_queue_size": (("1000",), "what a client sends waits in its socket, and nothing is lost"),
    "write_queue_size": (("1000",), "queues are bounded in bytes, and the newest message of a topic goes first"),
    "use_compression": (("false",), "a client asks for a compression with its subscription"),
    "use_events_executor": (("false",), "there is no executor"),
    "fragment_timeout": (("600",), "it is 600 s"),
    "delay_between_messages": (("0", "0.0"), "no message waits for another"),
    "max_message_size": (
        ("1000000", "10000000"),
        "no message is split unless its client asks for it; --max-message-bytes bounds what comes in",
    ),
    "call_services_in_new_thread": (("true", "false"), "calls never wait for each other"),
    "send_action_goals_in_new_thread": (("true", "false"), "goals never wait for each other"),
    "bson_only_mode": (("false",), "BSON is not spoken"),
    "binary_encoder": (("default",), "bytes are base64, or what the subscription asks for"),
}
"""By name: the values that need no word, and why others have no effect."""

_SWITCHES: Final = frozenset(
    ("use_compression", "use_events_executor", "call_services_in_new_thread", "send_action_goals_in_new_thread")
) | {"bson_only_mode"}


_UNSET: Final = (None, "", False, 0, "0", "false")
_OF_EVERY_NODE: Final = ("use_sim_time", "start_type_description_service", "qos_overrides")
_TRUTHS: Final = {
    **dict.fromkeys(("true", "yes", "y", "on"), True),
    **dict.fromkeys(("false", "no", "n", "off"), False),
}


def arguments(given: Sequence[str], known: Sequence[str], flags: Sequence[str]) -> list[str]:
    """Return the command line with ROS arguments, underscores and switches without a value as options of ours.

    ``known`` are the names of options, ``flags`` those that take no value. Raises ``ConfigError``.
    """
    viewers = "--foxglove" in given
    node = FOXGLOVE_NODE if viewers else NODE
    others, said = split(given, node)
    out: list[str] = []
    for index, argument in enumerate(others):
        name, equals, value = argument.partition("=")
        if not name.startswith("--"):
            out.append(argument)
            continue
        option = name.replace("_", "-")
        out.append(option + equals + value)
        if not equals and option[2:].replace("-", "_") in _SWITCHES:
            following = others[index + 1].lower() if index + 1 < len(others) else ""
            if following not in ("true", "false"):
                out.append("true")
    if said.node != NODE:  # what is left out stands for rosbridge's
        out.append(f"--name={said.node}")
    if said.log_level:
        out.append(f"--log-level={said.log_level}")
    for key, value in said.parameters.items():
        option = str(key).replace("_", "-")
        if viewers and key in UNUSED:
            if value not in _UNSET:
                said.notes.append(f"{key} ({UNUSED[key]})")
        elif option not in known:
            if not str(key).startswith(_OF_EVERY_NODE):
                said.notes.append(
                    f"the parameter {key} ({'foxglove_bridge' if viewers else 'rosbridge'} has none of this name)"
                )
        elif option in flags:
            out += [f"--{option}"] if _truth(key, value) else []
        elif value not in (None, ""):
            out.append(f"--{option}={_text(value)}")
    return out + [f"--note={note}" for note in said.notes]


def _truth(name: str, value: Any) -> bool:
    """Return the value of a switch, in any of the words of ROS 2. Raises ``ConfigError`` for other words."""
    found = _TRUTHS.get(str(value).lower())
    if found is None:
        raise ConfigError([(name, f"expected true or false, got {value!r}")], "--ros-args")
    return found


def notes(given: Mapping[str, Any]) -> list[str]:
    """Return which of ``given`` (by rosbridge's names) have no effect here, each with its reason."""
    out = []
    for name, (expected, reason) in WITHOUT_EFFECT.items():
        value = given.get(name)
        if value is not None and _text(value) not in expected:
            out.append(f"{name} ({reason})")
    return out + [f"{name} ({reason})" for name, reason in UNUSED.items() if given.get(name) not in _UNSET]


def _text(value: Any) -> str:
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return "[" + ",".join("'" + str(item).replace("'", "''") + "'" for item in value) + "]"
    return str(value).lower() if str(value).lower() in ("true", "false") else str(value)
