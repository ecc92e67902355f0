"""The types whose messages are fuzzed: standard ones, and one for every kind of field next to every other."""

from __future__ import annotations

from typing import Final

from ropeway.types import MessageCodec, TypeRegistry

__all__ = ["CODECS", "chosen"]

_DEFINITIONS: Final = {
    "fuzz/msg/Empty": "",
    "fuzz/msg/Inner": "uint8 a\nfloat64 b\nstring c\n",
    "fuzz/msg/Scalars": "bool a\nbyte b\nchar c\nint8 d\nint16 e\nuint32 f\nint64 g\nuint64 h\nfloat32 i\nfloat64 j\n"
    "string k\nwstring l\nstring<=5 m\nwstring<=5 n\nuint8 o\n",
    "fuzz/msg/Arrays": "bool[3] a\nbyte[3] b\nint16[2] c\nfloat64[2] d\nstring[2] e\n"
    "Inner[2] f\nEmpty[2] g\nuint8[1] h\n",
    "fuzz/msg/Sequences": "bool[] a\nuint8[] b\nint64[] c\nfloat32[] d\nstring[] e\n"
    "wstring[] f\nInner[] g\nEmpty[] h\n",
    "fuzz/msg/Bounded": "uint8[<=3] a\nfloat64[<=3] b\nstring<=4[<=2] c\nInner[<=2] d\nwstring<=4[2] e\n",
    "fuzz/msg/Nested": "Sequences[] a\nBounded b\nScalars[2] c\nbuiltin_interfaces/Time[] d\n",
    "fuzz/msg/Defaults": 'int32 a 7\nfloat32 b -1.5\nstring c "x"\nbool d true\nint32[] e [1, 2, 3]\n',
}
_NAMES: Final = (
    *_DEFINITIONS,
    "std_msgs/msg/String",
    "std_msgs/msg/Header",
    "sensor_msgs/msg/Image",
    "sensor_msgs/msg/PointCloud2",
    "sensor_msgs/msg/JointState",
    "diagnostic_msgs/msg/DiagnosticArray",
    "visualization_msgs/msg/MarkerArray",
    "tf2_msgs/msg/TFMessage",
    "nav_msgs/msg/Odometry",
    "rcl_interfaces/msg/ParameterEvent",
    "example_interfaces/action/Fibonacci_GetResult_Response",
)


def _codecs() -> tuple[MessageCodec, ...]:
    registry = TypeRegistry()
    for name, text in _DEFINITIONS.items():
        registry.add_text(name, text)
    return tuple(registry.codec(name) for name in _NAMES)


CODECS: Final = _codecs()


def chosen(data: bytes) -> tuple[MessageCodec, int, bytes]:
    """A codec by the first byte, the second byte, and what follows them."""
    head = data[:2].ljust(2, b"\0")
    return CODECS[head[0] % len(CODECS)], head[1], data[2:]
