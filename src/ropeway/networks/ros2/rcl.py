"""The few functions of rcl, ROS 2's client library in C, that rclpy has no Python for.

rclpy's objects tell the addresses of what they wrap; with these, messages are taken and published as they are on the
network, without the interpreter's lock and with the publisher's gid, which rclpy does not tell. The functions and
structures here are the same from Humble on; a gid grew shorter (24 bytes to 16) and stands at the end of what is read.
"""

from __future__ import annotations

import ctypes as ct
from typing import Any, Final

__all__ = ["GID_BYTES", "Rcl", "RclError"]

GID_BYTES: Final = 16
_OK: Final = 0
_TAKE_FAILED: Final = 401  # there was nothing to take
_GID_STORAGE: Final = 64  # more than any version writes


class RclError(RuntimeError):
    """A function of rcl failed; the text is rcl's."""


class _Allocator(ct.Structure):
    _fields_ = (
        ("allocate", ct.c_void_p),
        ("deallocate", ct.c_void_p),
        ("reallocate", ct.c_void_p),
        ("zero_allocate", ct.c_void_p),
        ("state", ct.c_void_p),
    )


class _Bytes(ct.Structure):
    """The struct rcutils_uint8_array_t."""

    _fields_ = (
        ("buffer", ct.c_void_p),
        ("length", ct.c_size_t),
        ("capacity", ct.c_size_t),
        ("allocator", _Allocator),
    )


class _Gid(ct.Structure):
    _fields_ = (("implementation", ct.c_char_p), ("data", ct.c_uint8 * _GID_STORAGE))


class _Info(ct.Structure):
    """The struct rmw_message_info_t, with room for what newer versions may add."""

    _fields_ = (
        ("source_ns", ct.c_int64),
        ("received_ns", ct.c_int64),
        ("publication_number", ct.c_uint64),
        ("reception_number", ct.c_uint64),
        ("gid", _Gid),
        ("spare", ct.c_uint8 * 128),
    )


class _ErrorText(ct.Structure):
    _fields_ = (("text", ct.c_char * 1024),)


class Rcl:
    """rcl as this process has loaded it for rclpy. Raises ``OSError`` where it cannot be found."""

    def __init__(self) -> None:
        self._rcl = ct.CDLL("librcl.so")
        self._rmw = ct.CDLL("librmw_implementation.so")
        utils = ct.CDLL("librcutils.so")
        pointer, size = ct.c_void_p, ct.c_size_t
        self._take = _function(
            self._rcl.rcl_take_serialized_message, ct.c_int, pointer, ct.POINTER(_Bytes), ct.POINTER(_Info), pointer
        )
        self._publish = _function(
            self._rcl.rcl_publish_serialized_message, ct.c_int, pointer, ct.POINTER(_Bytes), pointer
        )
        self._rmw_handle = _function(self._rcl.rcl_publisher_get_rmw_handle, pointer, pointer)
        self._gid_of = _function(self._rmw.rmw_get_gid_for_publisher, ct.c_int, pointer, ct.POINTER(_Gid))
        self._publisher_count = _function(
            self._rcl.rcl_subscription_get_publisher_count, ct.c_int, pointer, ct.POINTER(size)
        )
        self._wait_acked = _function(self._rcl.rcl_publisher_wait_for_all_acked, ct.c_int, pointer, ct.c_int64)
        self._graph_guard = _function(self._rcl.rcl_node_get_graph_guard_condition, pointer, pointer)
        self._add_guard = _function(self._rcl.rcl_wait_set_add_guard_condition, ct.c_int, pointer, pointer, pointer)
        self._init = _function(
            utils.rcutils_uint8_array_init, ct.c_int, ct.POINTER(_Bytes), size, ct.POINTER(_Allocator)
        )
        self._fini = _function(utils.rcutils_uint8_array_fini, ct.c_int, ct.POINTER(_Bytes))
        self._error = _function(utils.rcutils_get_error_string, _ErrorText)
        self._reset = _function(utils.rcutils_reset_error, None)
        self._allocator = _function(utils.rcutils_get_default_allocator, _Allocator)()

    def buffer(self) -> Buffer:
        """Make room for one message at a time; ``free`` it."""
        made = Buffer(_Bytes(), _Info())
        self._check(self._init(made.bytes, 4096, self._allocator), "rcutils_uint8_array_init")
        return made

    def free(self, buffer: Buffer) -> None:
        """Give a buffer's memory back."""
        self._fini(buffer.bytes)

    def take(self, subscription: int, buffer: Buffer) -> tuple[bytes, int, bytes] | None:
        """Take the next message of a subscription: its bytes, source time stamp (ns) and publisher's gid.

        ``None`` where there is none. Raises ``RclError``.
        """
        info = buffer.info
        code = self._take(subscription, buffer.bytes, info, None)
        if code == _TAKE_FAILED:
            self._reset()
            return None
        self._check(code, "rcl_take_serialized_message")
        payload = ct.string_at(buffer.bytes.buffer, buffer.bytes.length)
        return payload, info.source_ns, bytes(info.gid.data[:GID_BYTES])

    def publish(self, publisher: int, payload: bytes) -> None:
        """Publish CDR bytes. Raises ``RclError``."""
        address = ct.cast(ct.c_char_p(payload), ct.c_void_p)
        size = len(payload)
        self._check(
            self._publish(publisher, _Bytes(address, size, size, self._allocator), None),
            "rcl_publish_serialized_message",
        )

    def gid_of(self, publisher: int) -> bytes:
        """Return the gid that this process's readers see in the messages of a publisher. Raises ``RclError``."""
        gid = _Gid()
        self._check(self._gid_of(self._rmw_handle(publisher), gid), "rmw_get_gid_for_publisher")
        return bytes(gid.data[:GID_BYTES])

    def publisher_count(self, subscription: int) -> int:
        """Return how many publishers are matched with a subscription. Raises ``RclError``."""
        count = ct.c_size_t()
        self._check(self._publisher_count(subscription, count), "rcl_subscription_get_publisher_count")
        return count.value

    def wait_acked(self, publisher: int, timeout_s: float) -> None:
        """Wait until every reader has what was published, where the middleware can tell, or the time is over."""
        if self._wait_acked(publisher, int(timeout_s * 1e9)) != _OK:
            self._reset()

    def add_graph_guard(self, wait_set: int, node: int) -> None:
        """Let a wait set, which has room for it, wake up when anything in the graph changes. Raises ``RclError``."""
        guard = self._graph_guard(node)
        if guard:
            self._check(self._add_guard(wait_set, guard, None), "rcl_wait_set_add_guard_condition")

    def _check(self, code: int, what: str) -> None:
        if code == _OK:
            return
        text = self._error().text.decode("utf-8", "replace").partition(", at ")[0]
        self._reset()
        raise RclError(text or f"{what} returned {code}")


class Buffer:
    """Holds a taken message and its metadata until the next one."""

    __slots__ = ("bytes", "info")

    def __init__(self, bytes: _Bytes, info: _Info) -> None:
        self.bytes, self.info = bytes, info


def _function(function: Any, result: Any, *arguments: Any) -> Any:
    function.restype, function.argtypes = result, arguments
    return function
