"""Converts between ROS 2 names of topics, services and types and their DDS names.

A topic ``/scan`` is the DDS topic ``rt/scan`` of type ``sensor_msgs::msg::dds_::LaserScan_``; a service ``/add`` is
the pair ``rq/addRequest`` and ``rr/addReply``; an action is three services and two topics below ``/_action/``.
"""

from __future__ import annotations

import enum
import re
from dataclasses import dataclass
from functools import lru_cache
from typing import Final

from ropeway.limits import NAME_CHARACTERS, TYPE_NAME_CHARACTERS
from ropeway.types.definition import canonical_name

__all__ = [
    "DISCOVERY_TOPIC",
    "DISCOVERY_TYPE",
    "DISCOVERY_TYPE_HASH",
    "Name",
    "NameKind",
    "action_of",
    "action_of_feedback",
    "action_type",
    "dds_service_topics",
    "dds_topic",
    "dds_type",
    "demangle",
    "demangle_type",
    "is_hidden",
    "is_of_action",
]

DISCOVERY_TOPIC: Final = "ros_discovery_info"
DISCOVERY_TYPE: Final = "rmw_dds_common::msg::dds_::ParticipantEntitiesInfo_"
# What nodes of ROS 2 Jazzy announce for this type; without it Cyclone peers log a warning.
DISCOVERY_TYPE_HASH: Final = "RIHS01_91a0593bacdcc50ea9bdcf849a938b128412cc1ea821245c663bcd26f83c295e"

_DDS_TYPE: Final = re.compile(r"([A-Za-z]\w*)::(msg|srv|action)::dds_::([A-Za-z]\w*)_", re.ASCII)
_ACTION: Final = "/_action/"
_GOALS_SUFFIX: Final = "_SendGoal"
_FEEDBACK_SUFFIX: Final = "_FeedbackMessage"
_KEPT_CHARACTERS: Final = 2 * NAME_CHARACTERS + TYPE_NAME_CHARACTERS  # longer names are no names of ROS; none is kept


class NameKind(enum.Enum):
    """The role of a DDS topic in ROS."""

    TOPIC = "topic"
    REQUEST = "request"
    REPLY = "reply"
    FOREIGN = "foreign"


@dataclass(frozen=True, slots=True)
class Name:
    """A DDS topic as ROS calls it: ``name`` and ``type`` are ROS names, those of DDS where ``kind`` is FOREIGN."""

    kind: NameKind
    name: str
    type: str


def dds_type(name: str, suffix: str = "") -> str:
    """Return the DDS name of a ROS type: ``pkg::msg::dds_::Name_``; ``suffix`` is for parts of a service.

    Raises ``InvalidTypeName``.
    """
    package, kind, short = canonical_name(name).split("/")
    return f"{package}::{kind}::dds_::{short}{suffix}_"


def demangle_type(name: str) -> str:
    """Return the ROS name of a DDS type; a type that ROS would not have named is returned unchanged."""
    return (_demangle_type if len(name) <= _KEPT_CHARACTERS else _demangle_type.__wrapped__)(name)


@lru_cache(maxsize=4096)
def _demangle_type(name: str) -> str:
    match = _DDS_TYPE.fullmatch(name)
    return f"{match[1]}/{match[2]}/{match[3]}" if match else name


def dds_topic(name: str) -> str:
    """Return the DDS topic of an absolute ROS topic name."""
    return "rt" + name


def dds_service_topics(name: str) -> tuple[str, str]:
    """Return the DDS topics that carry the requests and the replies of an absolute ROS service name."""
    return f"rq{name}Request", f"rr{name}Reply"


def demangle(topic: str, type: str = "") -> Name:
    """Return the ROS name and role of the DDS topic ``topic`` of DDS type ``type``."""
    return (_demangle if len(topic) + len(type) <= _KEPT_CHARACTERS else _demangle.__wrapped__)(topic, type)


@lru_cache(maxsize=1024)
def _demangle(topic: str, type: str) -> Name:
    ros_type = demangle_type(type)
    prefix, slash, rest = topic.partition("/")
    if slash and rest:
        if prefix == "rt":
            return Name(NameKind.TOPIC, "/" + rest, ros_type)
        if prefix in ("rq", "rs") and rest.endswith("Request") and rest != "Request":
            return Name(NameKind.REQUEST, "/" + rest.removesuffix("Request"), ros_type.removesuffix("_Request"))
        if prefix in ("rr", "rs") and rest.endswith("Reply") and rest != "Reply":
            return Name(NameKind.REPLY, "/" + rest.removesuffix("Reply"), ros_type.removesuffix("_Response"))
    return Name(NameKind.FOREIGN, topic, ros_type)


def is_hidden(name: str) -> bool:
    """Return whether ROS tools leave the name out: a part begins with an underscore, as in an action's topics."""
    return "/_" in name


def is_of_action(name: str) -> bool:
    """Return whether the name is that of a topic or service that belongs to an action."""
    return _ACTION in name


def action_of(service: str, type: str = "") -> tuple[str, str] | None:
    """Return the action, and its type, that the service ``service`` sends goals to, or ``None`` for other services."""
    return _action(service, "send_goal", type, _GOALS_SUFFIX)


def goals_of(action: str) -> str:
    """Return the name of the service that an action takes goals by."""
    return f"{action}{_ACTION}send_goal"


def feedback_of(action: str) -> str:
    """Return the name of the topic that carries the feedback of an action."""
    return f"{action}{_ACTION}feedback"


def action_of_feedback(topic: str, type: str = "") -> tuple[str, str] | None:
    """Return the action, and its type, whose feedback the topic ``topic`` carries, or ``None`` for other topics."""
    return _action(topic, "feedback", type, _FEEDBACK_SUFFIX)


def action_type(type: str) -> str:
    """Return the type of the action that a service of type ``type`` sends goals to, or whose feedback has that type."""
    return type.removesuffix(_GOALS_SUFFIX).removesuffix(_FEEDBACK_SUFFIX)


def _action(name: str, part: str, type: str, suffix: str) -> tuple[str, str] | None:
    action, found, rest = name.partition(_ACTION)
    if not found or rest != part or not action:
        return None
    return action, type.removesuffix(suffix)
