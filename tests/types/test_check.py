"""The words in which a value is refused."""

from __future__ import annotations

import base64
from typing import Any

import cbor2
import numpy as np
import pytest

from ropeway.errors import ValueMismatch

from .messages import probe_registry

REGISTRY = probe_registry()


@pytest.mark.parametrize(
    ("name", "value", "field", "reason"),
    [
        ("std_msgs/Int32", [], "", "Expected a JSON object for type std_msgs/Int32 but received a <class 'list'>"),
        (
            "std_msgs/Int32",
            None,
            "",
            "Expected a JSON object for type std_msgs/Int32 but received a <class 'NoneType'>",
        ),
        (
            "std_msgs/Int32",
            {"data": 1.0},
            "data",
            "std_msgs/Int32 message requires a int32 for field data, but got a <class 'float'>",
        ),
        (
            "std_msgs/Float64",
            {"data": "1"},
            "data",
            "std_msgs/Float64 message requires a double for field data, but got a <class 'str'>",
        ),
        (
            "std_msgs/Bool",
            {"data": 1},
            "data",
            "std_msgs/Bool message requires a boolean for field data, but got a <class 'int'>",
        ),
        (
            "std_msgs/String",
            {"data": 1},
            "data",
            "std_msgs/String message requires a string for field data, but got a <class 'int'>",
        ),
        ("std_msgs/Int32", {"data": None}, "data", "msg is not a primitive type, but a <class 'NoneType'>"),
        ("std_msgs/Int8", {"data": 128}, "data", "The 'data' field must be an integer in [-128, 127]"),
        ("std_msgs/UInt8", {"data": -1}, "data", "The 'data' field must be an unsigned integer in [0, 255]"),
        ("std_msgs/Byte", {"data": 256}, "data", "The 'data' field must be an unsigned integer in [0, 255]"),
        (
            "std_msgs/Float32",
            {"data": 1e39},
            "data",
            "The 'data' field must be a float in [-3.402823466e+38, 3.402823466e+38]",
        ),
        (
            "std_msgs/Float64",
            {"data": 10**400},
            "data",
            "The 'data' field must be a float in [-1.7976931348623157e+308, 1.7976931348623157e+308]",
        ),
        (
            "geometry_msgs/Twist",
            {"linear": {"w": 1}},
            "linear.w",
            "Message type geometry_msgs/Twist does not have a field linear.w",
        ),
        ("geometry_msgs/Twist", {1: 2}, "1", "Message type geometry_msgs/Twist does not have a field 1"),
        ("std_msgs/Empty", {"x": 1}, "x", "Message type std_msgs/Empty does not have a field x"),
        (
            "geometry_msgs/Twist",
            {"linear": [1, 2, 3]},
            "linear",
            "geometry_msgs/Twist message requires a geometry_msgs/Vector3 for field linear, but got a <class 'list'>",
        ),
        (
            "nav_msgs/Path",
            {"poses": [{}, {"pose": {"position": {"x": "a"}}}]},
            "poses[1].pose.position.x",
            "nav_msgs/Path message requires a double for field poses.pose.position.x, but got a <class 'str'>",
        ),
        (
            "nav_msgs/Path",
            {"poses": {}},
            "poses",
            "requires a sequence<geometry_msgs/PoseStamped> for field poses, but got a <class 'dict'>",
        ),
        (
            "std_msgs/Header",
            {"stamp": "tomorrow"},
            "stamp",
            "Invalid string for builtin_interfaces/Time: 'tomorrow'",
        ),
        (
            "std_msgs/Header",
            {"stamp": {"sec": 1.5}},
            "stamp",
            "builtin_interfaces/Time takes whole numbers sec and nanosec, not {'sec': 1.5}",
        ),
        (
            "std_msgs/Header",
            {"stamp": {"secs": 2**31}},
            "stamp.sec",
            "The 'sec' field must be an integer in [-2147483648, 2147483647]",
        ),
        (
            "sensor_msgs/Imu",
            {"orientation_covariance": [0.0]},
            "orientation_covariance",
            "The 'orientation_covariance' field must have 9 elements, not 1",
        ),
        (
            "sensor_msgs/Imu",
            {"orientation_covariance": 1.0},
            "orientation_covariance",
            "sensor_msgs/Imu message requires a double[9] for field orientation_covariance, but got a <class 'float'>",
        ),
        ("sensor_msgs/Image", {"data": "abc"}, "data", "data is not base64: "),
        (
            "sensor_msgs/Image",
            {"data": [1, 2, 256]},
            "data[2]",
            "The 'data' field must be an unsigned integer in [0, 255]",
        ),
        (
            "sensor_msgs/LaserScan",
            {"ranges": [1.0, "x"]},
            "ranges[1]",
            "requires a float for field ranges, but got a <class 'str'>",
        ),
        ("sensor_msgs/LaserScan", {"ranges": b"abc"}, "ranges", "takes any number of values of type float, not b'abc'"),
        ("sensor_msgs/LaserScan", {"ranges": cbor2.CBORTag(85, b"abc")}, "ranges", "values of type float, not CBORTag"),
        (
            "sensor_msgs/JointState",
            {"name": ["a", 1]},
            "name[1]",
            "requires a string for field name, but got a <class 'int'>",
        ),
        (
            "sensor_msgs/JointState",
            {"name": "ab"},
            "name",
            "requires a sequence<string> for field name, but got a <class 'str'>",
        ),
        ("std_msgs/String", {"data": "\ud800"}, "data", "The 'data' field has half a surrogate pair"),
        ("probe/Scalars", {"short_text": "abcdef"}, "short_text", "must be string value not longer than 5"),
        ("probe/Scalars", {"short_wide": "abcdef"}, "short_wide", "must be string value not longer than 5"),
        ("probe/Bounded", {"inners": [{}] * 3}, "inners", "must have at most 2 elements, not 3"),
        ("probe/Bounded", {"bool_values": [True] * 4}, "bool_values", "must have at most 3 elements, not 4"),
        ("probe/Bounded", {"int32_values": np.zeros(4, "i4")}, "int32_values", "takes at most 3 values of type int32"),
        (
            "probe/Bounded",
            {"uint8_values": base64.b64encode(bytes(4)).decode()},
            "uint8_values",
            "at most 3 elements, not 4",
        ),
        ("probe/Sequences", {"bool_values": [True, 0]}, "bool_values[1]", "requires a boolean for field bool_values"),
        ("probe/Sequences", {"byte_values": [b"ab"]}, "byte_values[0]", "requires a octet for field byte_values"),
        ("probe/Arrays", {"inners": [{}]}, "inners", "The 'inners' field must have 2 elements, not 1"),
        ("probe/Times", {"pair": [{}, "x"]}, "pair[1]", "Invalid string for builtin_interfaces/Time: 'x'"),
        ("probe/Times", {"span": "now"}, "span", "Invalid string for builtin_interfaces/Duration: 'now'"),
    ],
)
def test_reasons(name: str, value: Any, field: str, reason: str) -> None:
    """Every misfit is told with its place and rosbridge's reason."""
    codec = REGISTRY.codec(name)
    for take in (codec.from_json, codec.from_cbor, codec.encode):
        with pytest.raises(ValueMismatch) as caught:
            take(value)
        assert caught.value.field == field
        assert reason in caught.value.reason
        assert caught.value.type == codec.type
