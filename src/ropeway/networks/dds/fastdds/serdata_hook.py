"""The hook: Cyclone DDS tells where each sample came from, and sends the related identity that Fast DDS asks for.

The library calls the functions of a table (``struct ddsi_serdata_ops``) for each serialised sample, or *serdata*. Four
of them are replaced here, once per process:

* ``from_ser`` makes a serdata of a received message. Behind its arguments lies the RTPS message, with the identity of
  the sample and its parameters; what ``identity.parse`` finds there is noted under the serdata's address.
* ``get_keyhash`` and ``to_ser_ref`` are called, in this order, while a message is put together. The writer is made to
  believe that a reader wants the key hash, so there is room for 16 bytes (and 8 more, of the status); once all
  parameters are in place, the related identity that was noted for the serdata is written over both.
* ``free`` is called when a serdata goes, and its note with it. So there are never more notes than samples in the
  library's own histories, which are bounded.

All this relies on memory layouts of known versions. Each is checked before it is relied upon, ``selfcall`` then
makes a call through the network, and it all happens in a process that nobody depends on. Functions that run on behalf
of the library never raise: what goes wrong there is counted in ``faults``.
"""

from __future__ import annotations

import ctypes as ct
import mmap
import os
import struct
from collections import Counter
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any, Final, NamedTuple

from ropeway.networks.dds import memory, raw
from ropeway.networks.dds.fastdds.identity import HEADER_BYTES, SampleIdentity, SampleOrigin, pack_parameter, parse
from ropeway.networks.dds.raw import DdsError, check, lib
from ropeway.networks.dds.raw_endpoints import tell_padding

__all__ = ["HookError", "RelatedWriter", "faults", "find_end", "install", "notes", "origin_of"]


class _Version(NamedTuple):
    """Says what differs from version to version; the rest of the layouts is the same in all of them."""

    no_key: bytes  # the hash of a key that a type lacks
    seq: int  # the number of the last sample in struct ddsi_writer, from the pointer to its sertype on


_VERSIONS: Final = {
    "11.0": _Version(no_key=bytes.fromhex("d41d8cd98f00b204e9800998ecf8427e"), seq=-112),
    "0.10": _Version(no_key=bytes(16), seq=-120),
}
# struct ddsi_sertype
_SERTYPE_OPS: Final = 8
_SERTYPE_NAME: Final = 32
# struct ddsi_serdata
_SERDATA_OPS: Final = 0
_SERDATA_STATUS: Final = 40
_WITH_LONG_STATUS: Final = 0x10000000  # a bit that Cyclone DDS sends as a second word of the status
# struct ddsi_serdata_ops, as indices of pointers
_GET_SIZE, _FROM_SER, _FROM_SER_IOV, _TO_SER_REF, _FREE, _GET_KEYHASH = 1, 2, 3, 7, 12, 14
_OPS: Final = 15  # two more follow in libraries with shared memory
# struct ddsi_rdata, which tells of (a fragment of) a received sample
_RDATA = struct.Struct("=QQIIHH")  # message, next fragment, first byte, end, submessage, payload
_MESSAGE_BYTES: Final = 48  # struct ddsi_rmsg; the RTPS message follows
_MAX_PARAMETER_BYTES: Final = 8192
# struct ddsi_writer, from the pointer to its sertype on: no mutex lies in between, whose size differs by machine
_FROM_TYPE: Final = {"whc": 40, "readers": 80, "keyhash": 88, "acks": 120}
_WRITER_GUID: Final = 4
_SEARCH_BYTES: Final = 1024
_MAX_READERS: Final = 100_000

_KEYHASH_PARAMETER = struct.pack("=HH", 0x0070, 16)
_STATUS_PARAMETER = struct.pack("=HH", 0x0071, 8)
_PAD_PARAMETER = bytes(4)
_MAGIC = b"ropeway related\0"  # the key hash until it is replaced: 16 bytes
_MAX_NOTES: Final = 65536

_FromSer = ct.CFUNCTYPE(ct.c_void_p, ct.c_void_p, ct.c_int, ct.c_void_p, ct.c_size_t)
_ToSerRef = ct.CFUNCTYPE(ct.c_void_p, ct.c_void_p, ct.c_size_t, ct.c_size_t, ct.c_void_p)
_GetKeyhash = ct.CFUNCTYPE(None, ct.c_void_p, ct.c_void_p, ct.c_bool)
_Free = ct.CFUNCTYPE(None, ct.c_void_p)
_GetSize = ct.CFUNCTYPE(ct.c_uint32, ct.c_void_p)

_u32_at = ct.c_uint32.from_address
_u64_at = ct.c_uint64.from_address


class HookError(Exception):
    """The library is not as it should be; the text says in what."""


faults: Counter[str] = Counter()
"""Counts what went wrong in calls from the library."""


class _Note:
    """The data noted about a received serdata (``origin``), or to be sent with one of ours (``parameter``)."""

    __slots__ = ("origin", "parameter", "slot")

    def __init__(self, origin: SampleOrigin | None = None, parameter: bytes = b"") -> None:
        self.origin, self.parameter = origin, parameter
        self.slot = 0  # where the key hash is in the message that is being put together


notes: dict[int, _Note] = {}
"""By address of the serdata."""


def origin_of(serdata: int) -> SampleOrigin | None:
    """Return the origin of a received sample; call this before its reference is given back."""
    note = notes.get(serdata)
    return note.origin if note is not None else None


# What the library calls ---------------------------------------------------------------------------------------------


class _Hook:
    """The functions that stand in the table, and those that stood there. Lives as long as the process."""

    def __init__(self, table: int) -> None:
        slots = (ct.c_uint64 * _OPS).from_address(table)
        self._from_ser = _FromSer(slots[_FROM_SER])
        self._to_ser_ref = _ToSerRef(slots[_TO_SER_REF])
        self._free = _Free(slots[_FREE])
        self.functions: dict[int, Any] = {
            _FROM_SER: _FromSer(self.from_ser),
            _TO_SER_REF: _ToSerRef(self.to_ser_ref),
            _FREE: _Free(self.free),
            _GET_KEYHASH: _GetKeyhash(self.get_keyhash),
        }

    def from_ser(self, sertype: int, kind: int, fragments: int, size: int) -> int:
        serdata: int = self._from_ser(sertype, kind, fragments, size)
        if serdata and kind == raw.SERDATA_DATA:
            try:
                _note_origin(serdata, fragments)
            except Exception as error:  # C calls this and takes no errors; they are counted
                faults[f"origin: {type(error).__name__}"] += 1
        return serdata

    def get_keyhash(self, serdata: int, buffer: int, force_md5: bool) -> None:
        ct.memset(buffer, 0, 16)
        note = notes.get(serdata)
        if note is not None and note.parameter:
            ct.memmove(buffer, _MAGIC, 16)
            note.slot = buffer

    def to_ser_ref(self, serdata: int, offset: int, size: int, out: int) -> int:
        if offset == 0:
            note = notes.get(serdata)
            if note is not None and note.slot:
                try:
                    _write_parameter(note)
                except Exception as error:  # C calls this and takes no errors; they are counted
                    faults[f"parameter: {type(error).__name__}"] += 1
        taken: int = self._to_ser_ref(serdata, offset, size, out)
        return taken

    def free(self, serdata: int) -> None:
        notes.pop(serdata, None)
        self._free(serdata)


def _note_origin(serdata: int, fragments: int) -> None:
    message, _, first, _, submessage_at, payload_at = _RDATA.unpack(ct.string_at(fragments, _RDATA.size))
    length = payload_at - submessage_at
    if first or submessage_at < HEADER_BYTES or not 0 < length <= _MAX_PARAMETER_BYTES:
        faults["message layout"] += 1
        return
    start = message + _MESSAGE_BYTES
    origin = parse(ct.string_at(start, HEADER_BYTES), ct.string_at(start + submessage_at, length))
    if origin is None:
        faults["no RTPS"] += 1
    elif len(notes) >= _MAX_NOTES:
        faults["too many samples"] += 1
    else:
        notes[serdata] = _Note(origin._replace(encoding=ct.string_at(start + payload_at, 2)))


def _write_parameter(note: _Note) -> None:
    """Replace key hash and status, 20 and 12 bytes, by the parameter of the note and padding, 28 and 4 bytes."""
    start, note.slot = note.slot - 4, 0
    expected = _KEYHASH_PARAMETER + _MAGIC + _STATUS_PARAMETER
    if ct.string_at(start, len(expected)) != expected:
        faults["message has moved"] += 1
        return
    ct.memmove(start, note.parameter + _PAD_PARAMETER, len(note.parameter) + 4)


# Putting it in place ------------------------------------------------------------------------------------------------

_hooks: dict[int, _Hook] = {}


def install(sertype: int, type_name: str) -> None:
    """Hook the table that ``sertype`` uses, which all types without a key share; later calls find it done.

    To be called before the first reader or writer of the process. Raises ``HookError``.
    """
    if _number() not in _VERSIONS:
        raise HookError(f"it needs Cyclone DDS {' or '.join(_VERSIONS)}, and this is {lib.name}")
    name = _read(_word(sertype + _SERTYPE_NAME), len(type_name) + 1)
    if name != type_name.encode() + b"\0":
        raise HookError("the name of a type is not where it should be")
    table = _word(sertype + _SERTYPE_OPS)
    if table in _hooks:
        return
    hook = _Hook(table)
    with _test_serdata(sertype) as (serdata, payload):
        _check_table(table, serdata, payload)
        with _writable(table, _OPS * 8):
            slots = (ct.c_uint64 * _OPS).from_address(table)
            for index, function in hook.functions.items():
                slots[index] = ct.cast(function, ct.c_void_p).value or 0
        _hooks[table] = hook
        notes[serdata] = _Note()
    if notes.pop(serdata, None) is not None:
        raise HookError("the end of a sample is not told")


def _number() -> str:
    return lib.version.split()[0]  # shared memory changes none of these layouts


def _check_table(table: int, serdata: int, payload: bytes) -> None:
    """See that the functions that matter are where they should be, by what the ones beside them do."""
    slots = (ct.c_uint64 * _OPS).from_buffer_copy(_read(table, _OPS * 8))
    if not all(slots):
        raise HookError("the table of functions has gaps")
    if _word(serdata + _SERDATA_OPS) != table or _GetSize(slots[_GET_SIZE])(serdata) != len(payload):
        raise HookError("the table of functions is another one")
    out = raw.IoVecOut()
    reference = _ToSerRef(slots[_TO_SER_REF])(serdata, 0, len(payload), ct.addressof(out))
    same = out.base is not None and ct.string_at(out.base, len(payload)) == payload
    lib.serdata_to_ser_unref(reference, ct.byref(out))
    keyhash = ct.create_string_buffer(b"\xff" * 17, 17)
    _GetKeyhash(slots[_GET_KEYHASH])(serdata, ct.addressof(keyhash), False)
    if not same or keyhash.raw != _VERSIONS[_number()].no_key + b"\xff":
        raise HookError("the table of functions has another order")


@contextmanager
def _test_serdata(sertype: int) -> Iterator[tuple[int, bytes]]:
    payload = b"\0\1\0\0" + bytes(range(64))
    serdata = raw.make_serdata(sertype, payload)
    if not serdata:
        raise HookError("a serialised sample is refused")
    try:
        yield serdata, payload
    finally:
        lib.serdata_unref(serdata)


@contextmanager
def _writable(address: int, size: int) -> Iterator[None]:
    """Make memory writable that the loader has made read-only, for the length of the ``with`` block."""
    start = address & -mmap.PAGESIZE
    length = address + size - start
    protect: Callable[[int, int, int], int] = ct.CFUNCTYPE(
        ct.c_int, ct.c_void_p, ct.c_size_t, ct.c_int, use_errno=True
    )(("mprotect", ct.CDLL(None)))
    if protect(start, length, mmap.PROT_READ | mmap.PROT_WRITE):
        raise HookError(f"the system does not let us change the table of functions ({os.strerror(ct.get_errno())})")
    try:
        yield
    finally:
        if protect(start, length, mmap.PROT_READ):
            faults["table stays writable"] += 1


# Writing ------------------------------------------------------------------------------------------------------------


class RelatedWriter:
    """Writes samples with a related identity on a DDS writer that was just made. Raises ``HookError``, ``DdsError``."""

    def __init__(self, entity: int, sertype: int) -> None:
        self.entity = entity
        self.guid = raw.guid_of(entity)
        self._sertype = sertype
        if _word(self._sertype + _SERTYPE_OPS) not in _hooks:
            raise HookError("a writer has a type that is not hooked")
        at = find_end(entity, self.guid, self._sertype)
        self._seq, self._keyhash = _u64_at(at + _VERSIONS[_number()].seq), _u32_at(at + _FROM_TYPE["keyhash"])
        self._acks = _u32_at(at + _FROM_TYPE["acks"])
        low, high = struct.unpack("=II", _read(at + _FROM_TYPE["whc"], 8))
        readers, reliable = struct.unpack("=II", _read(at + _FROM_TYPE["readers"], 8))
        if self._seq.value or self._keyhash.value or low > high or not reliable <= readers < _MAX_READERS:
            raise HookError("a writer's state is not where it should be")

    @property
    def acks(self) -> int:
        """The number of acknowledgements by readers, which send one once they are matched with this writer."""
        return self._acks.value

    def write(self, payload: bytes, parameter: int, related: SampleIdentity, stamp_ns: int) -> int:
        """Send CDR with its header; gives the sample's number. One thread at a time. Raises ``DdsError``."""
        serdata = raw.make_serdata(self._sertype, payload)
        if not serdata:
            raise DdsError("serialise", raw.BAD_PARAMETER)
        tell_padding(serdata, len(payload))
        notes[serdata] = _Note(parameter=pack_parameter(parameter, related))
        ct.c_int64.from_address(serdata + lib.timestamp_at).value = stamp_ns
        _u32_at(serdata + _SERDATA_STATUS).value = _WITH_LONG_STATUS
        if not self._keyhash.value:  # matches count it up and down
            self._keyhash.value = 1
        before = self._seq.value
        check(lib.forwardcdr(self.entity, serdata), "write")  # takes the reference over
        if self._seq.value != before + 1:
            raise HookError("a writer's number does not count")
        return before + 1


def find_end(entity: int, guid: bytes, sertype: int) -> int:
    """Return where a writer or reader keeps the pointer to its type, in the memory of the protocol's half of it."""
    pinned = ct.c_void_p()
    check(lib.entity_pin(entity, ct.byref(pinned)), "entity_pin")
    try:
        host_guid = struct.pack("=4I", *struct.unpack(">4I", guid))
        for word in memory.words(pinned.value or 0, _SEARCH_BYTES):
            if word % 8 == 0 and _read(word + _WRITER_GUID, 16) == host_guid:
                for index, pointer in enumerate(memory.words(word, _SEARCH_BYTES)):
                    if pointer == sertype:
                        return word + 8 * index
                break
    finally:
        lib.entity_unpin(pinned)
    raise HookError("a writer or reader is not found behind its handle")


# Reading memory that may not be there -------------------------------------------------------------------------------


def _read(address: int, size: int) -> bytes:
    """Return memory of this process, or ``b""`` if there is none at this address."""
    try:
        return memory.read(address, size)
    except OSError:
        raise HookError("this system has no /proc/self/mem") from None


def _word(address: int) -> int:
    data = _read(address, 8)
    if len(data) < 8:
        raise HookError("a pointer leads nowhere")
    return int.from_bytes(data, "little")
