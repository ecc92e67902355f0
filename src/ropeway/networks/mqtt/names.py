"""Names topics of a broker in ROS, and the other way round; checks and matches topic filters.

``factory/robot1/odom`` is ``/factory/robot1/odom``. A character that ROS does not allow stands as its code point in
hexadecimal: ``robot-1`` is ``robot_x2d_1``, a level that begins with a digit begins with the code of the digit, and an
empty level is ``_x_``. So every topic has one name, and every name leads back to one topic.
"""

from __future__ import annotations

import re
from typing import Final

from ropeway.errors import InvalidName
from ropeway.graph.base import resolve_name
from ropeway.limits import MQTT_TOPIC_BYTES

__all__ = ["check_filter", "check_topic", "is_pattern", "matches", "mqtt_topic", "ros_name"]

_EMPTY: Final = "_x_"
_PLAIN: Final = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")
_ODD: Final = re.compile(r"^[0-9]|[^A-Za-z0-9_]|_(?=x[0-9a-f]{1,6}(?:_|[^A-Za-z0-9_]))")
_CODED: Final = re.compile(r"_x([0-9a-f]{1,6})_")
_LAST_CODE_POINT: Final = 0x10FFFF
_SURROGATES: Final = range(0xD800, 0xE000)


def ros_name(topic: str) -> str:
    """Return the name in ROS of a topic. Raises ``InvalidName`` for one that is too long for a name."""
    return resolve_name("/" + "/".join(map(_encoded, topic.split("/"))))


def mqtt_topic(name: str) -> str:
    """Return the topic behind an absolute ROS name. Raises ``InvalidName`` where a broker would not take it."""
    return check_topic("/".join(map(_decoded, name[1:].split("/"))))


def check_topic(topic: str) -> str:
    """Return a topic to publish to, unless a broker would refuse it. Raises ``InvalidName``."""
    if not topic or any(c in topic for c in "+#\0"):
        raise InvalidName(topic, "a topic of a broker is a text without +, # and NUL")
    if topic.startswith("$SYS"):
        raise InvalidName(topic, "what begins with $SYS is the broker's own")
    if len(topic.encode(errors="surrogatepass")) > MQTT_TOPIC_BYTES:
        raise InvalidName(topic, f"a topic of a broker has at most {MQTT_TOPIC_BYTES} bytes")
    return topic


def check_filter(text: str) -> str:
    """Return a topic filter. Raises ``ValueError`` with the rule of MQTT that it breaks."""
    levels = text.split("/")
    if not text or "\0" in text or len(text.encode(errors="surrogatepass")) > MQTT_TOPIC_BYTES:
        raise ValueError(f"expected a topic of 1 to {MQTT_TOPIC_BYTES} bytes, or a filter such as factory/+/odom")
    if any("#" in level for level in levels[:-1]) or ("#" in levels[-1] and levels[-1] != "#"):
        raise ValueError(f"# stands alone at the end of a filter, as in factory/#, not as in {text[:80]!r}")
    if any("+" in level and level != "+" for level in levels):
        raise ValueError(f"+ stands for a whole level, as in factory/+/odom, not as in {text[:80]!r}")
    return text


def is_pattern(filter: str) -> bool:
    """Return whether a filter may match several topics."""
    return "+" in filter or "#" in filter


def matches(filter: str, topic: str) -> bool:
    """Return whether a filter matches a topic; one that begins with a wildcard matches none that begins with $."""
    if filter == topic:
        return True
    if not is_pattern(filter) or (topic.startswith("$") and filter[0] in "+#"):
        return False
    wanted, levels = filter.split("/"), topic.split("/")
    for number, level in enumerate(wanted):
        if level == "#":
            return True
        if number >= len(levels) or level not in ("+", levels[number]):
            return False
    return len(wanted) == len(levels)


def _encoded(level: str) -> str:
    if level in ("", _EMPTY):
        return "_x5f_x_" if level else _EMPTY
    return _ODD.sub(lambda found: f"_x{ord(found[0]):x}_", level)


def _decoded(level: str) -> str:
    return "" if level == _EMPTY else _CODED.sub(_character, level)


def _character(found: re.Match[str]) -> str:
    code = int(found[1], 16)
    return found[0] if code > _LAST_CODE_POINT or code in _SURROGATES else chr(code)
