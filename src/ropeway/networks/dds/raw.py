"""Serialised messages in and out of Cyclone DDS, by ctypes on its C library.

Its Python classes serialise in Python; the library can do without. A topic made here has an opaque type of one
octet under the name of the real type, and Cyclone DDS passes whatever CDR follows through unread. Since neither side
then has type information to compare, endpoints match by name, as those of ROS 2 do.

Functions keep their C names less the ``dds_`` prefix. They are looked up by ``load()``, once per process, in the
library that ``library`` finds; what older versions lack is made up for. ``selftest`` then finds which of the known
memory layouts it has, against a live participant. Every function returns what the C function returns: negative numbers
are errors, which ``check`` raises as ``DdsError``.

Two kinds of prototypes: functions that may block or copy much release the GIL, the small ones hold it.
"""

from __future__ import annotations

import ctypes as ct
import struct
from collections.abc import Callable
from typing import Any, Final

from ropeway.errors import GraphUnavailable
from ropeway.networks.dds import library, memory

__all__ = [
    "ALIVE",
    "ANY_STATE",
    "BAD_PARAMETER",
    "BUILTIN_PARTICIPANT",
    "BUILTIN_PUBLICATION",
    "BUILTIN_SUBSCRIPTION",
    "INFINITY",
    "INFO",
    "PRECONDITION_NOT_MET",
    "PUBLICATION_MATCHED",
    "SAMPLES_PER_TAKE",
    "SERDATA_DATA",
    "SUBSCRIPTION_MATCHED",
    "TIMEOUT",
    "BuiltinEndpoint",
    "DdsError",
    "IoVec",
    "IoVecOut",
    "Lib",
    "ParticipantData",
    "SampleInfo",
    "check",
    "guid_of",
    "handle_of",
    "lib",
    "load",
    "user_data_of",
]

INFINITY: Final = 2**63 - 1
TIMEOUT: Final = -10
BAD_PARAMETER: Final = -3
PRECONDITION_NOT_MET: Final = -4
ANY_STATE: Final = 127
ALIVE: Final = 16  # instance state

_PSEUDO: Final = 0x7FFF0000
BUILTIN_PARTICIPANT: Final = _PSEUDO + 1
BUILTIN_PUBLICATION: Final = _PSEUDO + 3
BUILTIN_SUBSCRIPTION: Final = _PSEUDO + 4

PUBLICATION_MATCHED: Final = 1 << 11
SUBSCRIPTION_MATCHED: Final = 1 << 12

SERDATA_DATA: Final = 2  # a sample, not only its key
SAMPLES_PER_TAKE: Final = 64

_i32, _u32, _i64, _u64, _vp, _size = ct.c_int32, ct.c_uint32, ct.c_int64, ct.c_uint64, ct.c_void_p, ct.c_size_t
_out = ct.POINTER

Function = Callable[..., Any]


class DdsError(Exception):
    """An error code of Cyclone DDS: ``code`` is negative, ``action`` is what was tried."""

    def __init__(self, action: str, code: int) -> None:
        self.action, self.code = action, code
        text = lib.strretcode(code).decode() if lib.loaded else "not loaded"
        super().__init__(f"{action}: {text} ({code})")


class SampleInfo(ct.Structure):
    """``dds_sample_info_t``."""

    _fields_ = (
        ("sample_state", _u32),
        ("view_state", _u32),
        ("instance_state", _u32),
        ("valid", ct.c_bool),
        ("source_timestamp", _i64),
        ("instance_handle", _u64),
        ("publication_handle", _u64),
        ("disposed_generation", _u32),
        ("no_writers_generation", _u32),
        ("sample_rank", _u32),
        ("generation_rank", _u32),
        ("absolute_generation_rank", _u32),
    )


INFO: Final = struct.Struct("=8xI?3xqQQ20x4x")  # instance_state, valid, source_timestamp, both handles


class IoVec(ct.Structure):
    """A piece of a sample to be written; keeps its bytes alive."""

    _fields_ = (("base", ct.c_char_p), ("len", _size))


class IoVecOut(ct.Structure):
    """A piece of a sample in the memory of the library."""

    _fields_ = (("base", _vp), ("len", _size))


class _TypeMeta(ct.Structure):
    _fields_ = (("data", _vp), ("size", _u32))


class _TopicDescriptor(ct.Structure):
    _fields_ = (
        ("size", _u32),
        ("align", _u32),
        ("flags", _u32),
        ("key_count", _u32),
        ("type_name", ct.c_char_p),
        ("keys", _vp),
        ("op_count", _u32),
        ("ops", ct.POINTER(_u32)),
        ("meta", ct.c_char_p),
        ("type_information", _TypeMeta),
        ("type_mapping", _TypeMeta),
        ("representations", _u32),
    )


class BuiltinEndpoint(ct.Structure):
    """``dds_builtintopic_endpoint_t``: a writer or reader that was discovered."""

    _fields_ = (
        ("key", ct.c_uint8 * 16),
        ("participant_key", ct.c_uint8 * 16),
        ("participant_handle", _u64),
        ("topic", ct.c_char_p),
        ("type", ct.c_char_p),
        ("qos", _vp),
    )


class ParticipantData(ct.Structure):
    """``dds_builtintopic_participant_t``."""

    _fields_ = (("key", ct.c_uint8 * 16), ("qos", _vp))


# name -> (releases the GIL, result, arguments)
_PROTOTYPES: Final[dict[str, tuple[bool, Any, tuple[Any, ...]]]] = {
    "dds_strretcode": (False, ct.c_char_p, (_i32,)),
    "dds_create_domain": (True, _i32, (_u32, ct.c_char_p)),
    "dds_create_participant": (True, _i32, (_u32, _vp, _vp)),
    "dds_create_topic": (True, _i32, (_i32, ct.POINTER(_TopicDescriptor), ct.c_char_p, _vp, _vp)),
    "dds_create_reader": (True, _i32, (_i32, _i32, _vp, _vp)),
    "dds_create_writer": (True, _i32, (_i32, _i32, _vp, _vp)),
    "dds_create_readcondition": (True, _i32, (_i32, _u32)),
    "dds_create_guardcondition": (True, _i32, (_i32,)),
    "dds_create_waitset": (True, _i32, (_i32,)),
    "dds_delete": (True, _i32, (_i32,)),
    "dds_get_children": (True, _i32, (_i32, _vp, _size)),
    "dds_waitset_attach": (True, _i32, (_i32, _i32, ct.c_ssize_t)),
    "dds_waitset_detach": (True, _i32, (_i32, _i32)),
    "dds_waitset_wait": (True, _i32, (_i32, _vp, _size, _i64)),
    "dds_set_guardcondition": (True, _i32, (_i32, ct.c_bool)),
    "dds_take_guardcondition": (True, _i32, (_i32, _out(ct.c_bool))),
    "dds_set_status_mask": (True, _i32, (_i32, _u32)),
    "dds_take_status": (True, _i32, (_i32, _out(_u32), _u32)),
    "dds_wait_for_acks": (True, _i32, (_i32, _i64)),
    "dds_get_guid": (True, _i32, (_i32, _vp)),
    "dds_entity_pin": (True, _i32, (_i32, _out(_vp))),
    "dds_entity_unpin": (True, None, (_vp,)),
    "dds_get_instance_handle": (True, _i32, (_i32, _out(_u64))),
    "dds_get_entity_sertype": (True, _i32, (_i32, _out(_vp))),
    "dds_get_matched_subscriptions": (True, _i32, (_i32, _vp, _size)),
    "dds_get_matched_publications": (True, _i32, (_i32, _vp, _size)),
    "dds_get_matched_subscription_data": (True, ct.POINTER(BuiltinEndpoint), (_i32, _u64)),
    "dds_get_matched_publication_data": (True, ct.POINTER(BuiltinEndpoint), (_i32, _u64)),
    "dds_builtintopic_free_endpoint": (False, None, (_vp,)),
    "dds_take": (True, _i32, (_i32, _vp, _vp, _size, _u32)),
    "dds_read": (True, _i32, (_i32, _vp, _vp, _size, _u32)),
    "dds_return_loan": (True, _i32, (_i32, _vp, _i32)),
    "dds_takecdr": (True, _i32, (_i32, _vp, _u32, _vp, _u32)),
    "dds_writecdr": (True, _i32, (_i32, _vp)),
    "dds_forwardcdr": (True, _i32, (_i32, _vp)),
    "ddsi_serdata_from_ser_iov": (False, _vp, (_vp, ct.c_int, _size, _vp, _size)),
    "ddsi_serdata_to_ser": (True, None, (_vp, _size, _size, _vp)),
    "ddsi_serdata_to_ser_ref": (False, _vp, (_vp, _size, _size, ct.POINTER(IoVecOut))),
    "ddsi_serdata_to_ser_unref": (False, None, (_vp, ct.POINTER(IoVecOut))),
    "ddsi_serdata_size": (False, _u32, (_vp,)),
    "ddsi_serdata_unref": (False, None, (_vp,)),
    "dds_create_qos": (False, _vp, ()),
    "dds_delete_qos": (False, None, (_vp,)),
    "dds_free": (False, None, (_vp,)),
    "dds_qset_userdata": (False, None, (_vp, ct.c_char_p, _size)),
    "dds_qset_durability": (False, None, (_vp, ct.c_int)),
    "dds_qset_durability_service": (False, None, (_vp, _i64, ct.c_int, _i32, _i32, _i32, _i32)),
    "dds_qset_history": (False, None, (_vp, ct.c_int, _i32)),
    "dds_qset_reliability": (False, None, (_vp, ct.c_int, _i64)),
    "dds_qset_deadline": (False, None, (_vp, _i64)),
    "dds_qset_lifespan": (False, None, (_vp, _i64)),
    "dds_qset_ignorelocal": (False, None, (_vp, ct.c_int)),
    "dds_qset_writer_batching": (False, None, (_vp, ct.c_bool)),
    "dds_write_flush": (True, _i32, (_i32,)),
    "dds_qset_writer_data_lifecycle": (False, None, (_vp, ct.c_bool)),
    "dds_qset_data_representation": (False, None, (_vp, _u32, ct.POINTER(ct.c_int16))),
    "dds_qget_userdata": (False, ct.c_bool, (_vp, _out(_vp), _out(_size))),
    "dds_qget_durability": (False, ct.c_bool, (_vp, _out(ct.c_int))),
    "dds_qget_history": (False, ct.c_bool, (_vp, _out(ct.c_int), _out(_i32))),
    "dds_qget_reliability": (False, ct.c_bool, (_vp, _out(ct.c_int), _out(_i64))),
    "dds_qget_deadline": (False, ct.c_bool, (_vp, _out(_i64))),
    "dds_qget_lifespan": (False, ct.c_bool, (_vp, _out(_i64))),
}


class Lib:
    """The functions of the library, as attributes, once ``load()`` has found them, and its layout."""

    loaded = False
    name = "Cyclone DDS"
    """The library for people: its path and version."""

    answers_from_loopback = True
    """Whether it reaches, from the loopback interface, nodes of this machine that tell the address of another one."""

    version = library.LAYOUTS[0].version
    timestamp_at = library.LAYOUTS[0].timestamp
    size_at = library.LAYOUTS[0].size
    header_at = library.LAYOUTS[0].header

    def use(self, layout: library.Layout) -> None:
        """Read and write serialised samples in this layout from now on."""
        self.version, self.timestamp_at, self.size_at, self.header_at = layout

    strretcode: Function
    create_domain: Function
    create_participant: Function
    create_topic: Function
    create_reader: Function
    create_writer: Function
    create_readcondition: Function
    create_guardcondition: Function
    create_waitset: Function
    delete: Function
    get_children: Function
    waitset_attach: Function
    waitset_detach: Function
    waitset_wait: Function
    set_guardcondition: Function
    take_guardcondition: Function
    set_status_mask: Function
    take_status: Function
    wait_for_acks: Function
    get_guid: Function
    entity_pin: Function
    entity_unpin: Function
    get_instance_handle: Function
    get_entity_sertype: Function
    get_matched_subscriptions: Function
    get_matched_publications: Function
    get_matched_subscription_data: Function
    get_matched_publication_data: Function
    builtintopic_free_endpoint: Function
    take: Function
    read: Function
    return_loan: Function
    takecdr: Function
    writecdr: Function
    forwardcdr: Function
    serdata_from_ser_iov: Function
    serdata_from_ser_iov_nogil: Function
    serdata_to_ser: Function
    serdata_to_ser_ref: Function
    serdata_to_ser_unref: Function
    serdata_size: Function
    serdata_unref: Function
    create_qos: Function
    delete_qos: Function
    free: Function
    qset_userdata: Function
    qset_durability: Function
    qset_durability_service: Function
    qset_history: Function
    qset_reliability: Function
    qset_deadline: Function
    qset_lifespan: Function
    qset_ignorelocal: Function
    qset_writer_batching: Function
    write_flush: Function
    qset_writer_data_lifecycle: Function
    qset_data_representation: Function
    qget_userdata: Function
    qget_durability: Function
    qget_history: Function
    qget_reliability: Function
    qget_deadline: Function
    qget_lifespan: Function


lib: Final = Lib()

# The smallest type that every ROS message satisfies: a struct of one octet.
_OCTET_OPS = (_u32 * 3)(0x01010000, 0, 0)


def load(graph: str) -> None:
    """Find the library and its functions; raises ``GraphUnavailable`` where there is none, or another one."""
    if lib.loaded:
        return
    try:
        found = library.find()
    except library.LibraryMissing as error:
        raise GraphUnavailable(graph, str(error)) from None
    stand_ins = _stand_ins(found.dll)
    for symbol, (releases_gil, result, arguments) in _PROTOTYPES.items():
        kind = ct.CFUNCTYPE if releases_gil else ct.PYFUNCTYPE
        try:
            function: Function = kind(result, *arguments)((symbol, found.dll))
        except AttributeError:
            if symbol not in stand_ins:
                raise GraphUnavailable(
                    graph, f"{found.path} lacks {symbol}, so Ropeway does not know this build; see docs/install.md"
                ) from None
            function = stand_ins[symbol]
            Lib.answers_from_loopback = False  # 0.10, which does not look where a packet came from
        setattr(lib, symbol.removeprefix("dds_").removeprefix("ddsi_"), function)
    _, result, arguments = _PROTOTYPES["ddsi_serdata_from_ser_iov"]
    lib.serdata_from_ser_iov_nogil = ct.CFUNCTYPE(result, *arguments)(("ddsi_serdata_from_ser_iov", found.dll))
    Lib.name = f"{found.path} {found.version}".rstrip()
    Lib.loaded = True


_MAX_TOPIC_BYTES: Final = 1024  # of which an entity's own part is a third


def _stand_ins(dll: ct.CDLL) -> dict[str, Function]:
    """Return what takes the place of functions that 0.10 lacks."""

    def get_entity_sertype(topic: int, out: Any) -> int:
        """Find the sertype behind a topic by its table of functions, which has a name."""
        try:
            table = ct.addressof(ct.c_char.in_dll(dll, "ddsi_sertype_ops_default"))
        except ValueError:
            return BAD_PARAMETER
        pinned = _vp()
        code: int = lib.entity_pin(topic, ct.byref(pinned))
        if code < 0:
            return code
        try:
            for pointer in memory.words(pinned.value or 0, _MAX_TOPIC_BYTES):
                if memory.read(pointer, 8) == table.to_bytes(8, "little"):
                    out._obj.value = pointer
                    return 0
        finally:
            lib.entity_unpin(pinned)
        return BAD_PARAMETER

    return {
        "dds_get_entity_sertype": get_entity_sertype,
        "dds_qset_writer_batching": lambda _qos, _batch: None,  # each sample goes at once, as it always did there
    }


def check(code: int, action: str) -> int:
    """Return ``code`` unless it is an error; otherwise raise ``DdsError``."""
    if code < 0:
        raise DdsError(action, code)
    return code


def guid_of(entity: int) -> bytes:
    """Return the 16 bytes that name an entity on the network."""
    buffer = ct.create_string_buffer(16)
    check(lib.get_guid(entity, buffer), "get_guid")
    return buffer.raw


def handle_of(entity: int) -> int:
    """Return the number that names an entity in this process."""
    out = _u64()
    check(lib.get_instance_handle(entity, ct.byref(out)), "get_instance_handle")
    return out.value


def create_topic(participant: int, name: str, type_name: str) -> tuple[int, int]:
    """Create an opaque topic and return its entity and its sertype."""
    # Cyclone DDS copies all of the descriptor that it keeps.
    descriptor = _TopicDescriptor(size=1, align=1, type_name=type_name.encode(), op_count=2, ops=_OCTET_OPS, meta=b"")
    entity = check(
        lib.create_topic(participant, ct.byref(descriptor), name.encode(), None, None), f"create topic {name}"
    )
    sertype = _vp()
    check(lib.get_entity_sertype(entity, ct.byref(sertype)), "get_entity_sertype")
    assert sertype.value is not None
    return entity, sertype.value


def user_data_of(qos: int) -> bytes:
    """Return the USER_DATA of a qos object."""
    value, size = _vp(), _size()
    if not lib.qget_userdata(qos, ct.byref(value), ct.byref(size)) or not value.value:
        return b""
    data = ct.string_at(value.value, size.value)
    lib.free(value)
    return data


def make_serdata(sertype: int, payload: bytes) -> int:
    """Return a reference to a serialised sample with a copy of ``payload``, or 0 if that is not CDR."""
    vector = IoVec(payload, len(payload))
    made = lib.serdata_from_ser_iov(sertype, SERDATA_DATA, 1, ct.byref(vector), len(payload))
    return made or 0


def matched(get: Callable[..., Any], entity: int) -> list[int]:
    """Return the handles of what an entity is matched with; ``get`` is one of ``lib.get_matched_…``."""
    room = 64
    while True:
        handles = (ct.c_uint64 * room)()
        try:
            count = check(get(entity, handles, room), "get_matched")
        except DdsError:
            return []
        if count <= room:
            return list(handles[:count])
        room = count + 16
