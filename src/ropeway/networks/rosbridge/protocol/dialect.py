"""Defines the dialects of rosbridge: rosbridge itself, the original ROS Gateway (rosgw), and other Ropeway gateways.

Another Ropeway gateway is known by the WebSocket subprotocol. A plain peer is taken for rosbridge until it does
something that only rosgw does: ``by_server`` tells from the answer of a server, ``detect`` from what a peer says.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from ropeway.listener.subprotocols import ROPEWAY_SUBPROTOCOL

if TYPE_CHECKING:
    from ropeway.networks.rosbridge.protocol.ops import Op

__all__ = [
    "DIALECTS",
    "ROPEWAY",
    "ROPEWAY_SUBPROTOCOL",
    "ROSBRIDGE",
    "ROSGW",
    "Dialect",
    "by_server",
    "by_subprotocol",
    "detect",
]


@dataclass(frozen=True, slots=True)
class Dialect:
    """Describes what a peer understands.

    ``subscribe`` and ``publish`` are the encodings in which it may be sent what it subscribed to, and in which it
    takes what is published to it. ``bodies`` are the binary ones that it may ask for with the ``compression`` of a
    request, of a goal, or of a service or action that it offers. ``tagged``: typed arrays in CBOR carry RFC 8746 tags
    (otherwise they are bare byte strings). ``names_compression``: a message names its encoding under ``compression``.
    ``fragments``: it puts ``fragment`` operations together. ``cancels``: it knows ``cancel_action_goal``. ``records``:
    binary frames are ``ropeway.networks.rosbridge.protocol.records``.
    """

    name: str
    subscribe: frozenset[str]
    publish: frozenset[str]
    bodies: frozenset[str]
    tagged: bool = True
    names_compression: bool = False
    fragments: bool = True
    cancels: bool = True
    records: bool = False

    def __str__(self) -> str:
        return self.name


_ROSGW_ENCODINGS: Final = frozenset(("none", "cbor", "cbor-raw", "zip", "rawzip"))
_ALL: Final = _ROSGW_ENCODINGS | {"png", "zstd"}

ROSBRIDGE: Final = Dialect(
    "rosbridge",
    subscribe=frozenset(("none", "png", "cbor", "cbor-raw")),
    publish=frozenset(("none",)),
    bodies=frozenset(("cbor", "cbor-raw")),
)
ROSGW: Final = Dialect(
    "rosgw",
    subscribe=_ROSGW_ENCODINGS,
    publish=_ROSGW_ENCODINGS,
    bodies=_ROSGW_ENCODINGS - {"none"},
    tagged=False,
    names_compression=True,
    fragments=False,
    cancels=False,
)
ROPEWAY: Final = Dialect(
    "ropeway", subscribe=_ALL, publish=_ALL, bodies=frozenset(), names_compression=True, records=True
)

DIALECTS: Final = {dialect.name: dialect for dialect in (ROSBRIDGE, ROSGW, ROPEWAY)}

_ROSBRIDGE_SERVERS: Final = ("tornado", "autobahn", "websocket++")

# rosgw numbers its requests below 32 hexadecimal digits that name its bridge, and its calls and goals are such digits;
# no client library does either
_ROSGW_ID: Final = re.compile(
    r"(?:un)?(?:advertise|subscribe):[0-9a-f]{32}:\d+|(?:expose|del)(?:srv|act):[0-9a-f]{32}:\d+"
    r"|(?:svc|act):[0-9a-f]{32}"
)
_ROSGW_ONLY: Final = frozenset(("zip", "rawzip"))


def by_subprotocol(subprotocol: str | None) -> Dialect:
    """Return the dialect of a peer that has just connected with this WebSocket subprotocol, or none."""
    return ROPEWAY if subprotocol == ROPEWAY_SUBPROTOCOL else ROSBRIDGE


def by_server(server: str, *, dated: bool) -> Dialect | None:
    """Return the dialect of a server without our subprotocol, from the head of its answer; ``None`` leaves it open.

    ``server`` is its ``Server`` line, ``dated`` tells whether it had a ``Date``. rosbridge servers stand on Tornado,
    Autobahn (ROS 1) or WebSocket++; the library below rosgw gives a date and no name.
    """
    if server.lower().startswith(_ROSBRIDGE_SERVERS):
        return ROSBRIDGE
    return ROSGW if dated and not server else None


def detect(dialect: Dialect, op: Op) -> Dialect:
    """Return the dialect of a peer that spoke ``dialect`` so far and now sends ``op``.

    Signs of rosgw: an encoding named in anything but ``subscribe``, an encoding that rosbridge has not, an id as
    only rosgw makes it.
    """
    if dialect is not ROSBRIDGE:
        return dialect
    compression, id = op.compression, op.id
    if compression is not None and (compression in _ROSGW_ONLY or op.op not in _COMPRESSION_OF_ROSBRIDGE):
        return ROSGW
    return ROSGW if isinstance(id, str) and _ROSGW_ID.fullmatch(id) else dialect


# rosbridge's own clients name an encoding here, and the server ignores it in the latter two
_COMPRESSION_OF_ROSBRIDGE: Final = frozenset(("subscribe", "call_service", "send_action_goal"))
