"""Readers and writers of serialised samples, on any DDS topic and type: the hot path."""

from __future__ import annotations

import asyncio
import contextlib
import ctypes as ct
from collections import Counter, deque
from collections.abc import Callable
from typing import TYPE_CHECKING, Final, NamedTuple, Protocol

from ropeway.graph.base import SEQ_NONE, Sample, Undelivered
from ropeway.networks.dds.raw import (
    ANY_STATE,
    INFO,
    SAMPLES_PER_TAKE,
    SERDATA_DATA,
    IoVec,
    SampleInfo,
    check,
    lib,
)

if TYPE_CHECKING:
    from ropeway.networks.dds.byteorder import ByteOrder
    from ropeway.networks.dds.matching import Matches
    from ropeway.networks.dds.waitset import Pump
    from ropeway.networks.dds.writer_thread import Courier

__all__ = ["RawReader", "RawWriter", "Taken", "WriterIdentity", "tell_padding", "without_padding"]

_HEADER_BYTES: Final = 4
_OPTIONS_AT: Final = 3  # in the header; the two lowest bits count the padding (DDSI-RTPS 2.5, 10.2)
_NO_OPTIONS: Final = b"\0\0"
_COPY_WITHOUT_GIL_BYTES: Final = 32768  # above, copying costs more than letting go of the GIL
_PENDING_LIMIT_BYTES: Final = 256 << 20
_COURIER_BYTES: Final = 1 << 20  # about a millisecond on the network
_MAX_STAMP: Final = 2**31 * 10**9 - 1  # what a source timestamp on the wire can hold for every vendor

_byref = ct.byref
_u8_at = ct.c_uint8.from_address
_u32_at = ct.c_uint32.from_address
_i64_at = ct.c_int64.from_address
_new_bytes = ct.PYFUNCTYPE(ct.py_object, ct.c_void_p, ct.c_ssize_t)(("PyBytes_FromStringAndSize", ct.pythonapi))
_address_of = ct.PYFUNCTYPE(ct.c_void_p, ct.py_object)(("PyBytes_AsString", ct.pythonapi))


class WriterIdentity(NamedTuple):
    """Identifies the writer of a sample. ``wanted`` is false for writers of our own gateway; those of a ``helper``
    speak otherwise.
    """

    guid: bytes
    relayed: bool = False
    wanted: bool = True
    helper: bool = False


class Taken:
    """Holds what one call takes from a reader; the readers of a participant share it, in the pump's thread."""

    def __init__(self) -> None:
        self.refs = (ct.c_uint64 * SAMPLES_PER_TAKE)()
        self.infos = (SampleInfo * SAMPLES_PER_TAKE)()
        self.raw = memoryview(self.infos).cast("B")


class ParticipantHost(Protocol):
    """The services of a participant for its readers and writers."""

    pump: Pump
    courier: Courier
    clock: Callable[[], int]
    identities: dict[int, WriterIdentity]
    taken: Taken

    def identify(self, reader: int, handle: int) -> WriterIdentity:
        """Return who the writer behind a publication handle is, where discovery has not told yet."""
        ...


class RawReader:
    """Takes samples in the pump's thread and gives them to ``deliver`` on the loop, in batches, oldest first.

    Its entity stays empty: what the loop has no room for waits here as references, and of these the newest ``depth``
    (and 256 MB) survive; ``dropped`` tells on the loop how many did not, and why. ``order`` finds big-endian writers.
    """

    def __init__(
        self,
        participant: ParticipantHost,
        topic: tuple[str, str],
        type: str,
        entity: int,
        depth: int | None,
        deliver: Callable[[list[Sample]], None],
        dropped: Callable[[list[tuple[Undelivered, int]]], None],
        order: ByteOrder | None,
        *,
        all_gateways: bool = False,
    ) -> None:
        self.topic, self.type, self.entity = topic, type, entity
        self.guid = b""
        self.closed = False
        self.matches: Matches | None = None
        self._all_gateways = all_gateways
        self._participant = participant
        self._pump = participant.pump
        self._clock = participant.clock
        self._identities = participant.identities
        self._depth = depth
        self._deliver, self._dropped = deliver, dropped
        self._order = order
        self._taken = participant.taken
        self._pending: deque[tuple[int, int, int, int, WriterIdentity]] | None = None
        self._pending_bytes = 0
        self._drops: Counter[Undelivered] = Counter()
        self.key = 0

    def on_data(self) -> None:
        """Take what is there, hand over what there is room for, and trim what stays."""
        if self.closed:
            return
        taken, unref = self._taken, lib.serdata_unref
        count = lib.takecdr(self.entity, taken.refs, SAMPLES_PER_TAKE, taken.infos, ANY_STATE)
        if count < 0:
            check(count, "takecdr")
        pending = self._pending
        if pending is None:
            pending = self._pending = deque()
        if count > 0:
            stamp, identities, everyone, size_at = self._clock(), self._identities, self._all_gateways, lib.size_at
            for serdata, (_, valid, source_stamp, _, handle) in zip(
                taken.refs[:count], INFO.iter_unpack(taken.raw[: count * INFO.size]), strict=True
            ):
                if valid:
                    identity = identities.get(handle) or self._participant.identify(self.entity, handle)
                    if (identity.wanted or everyone) and not identity.helper:
                        length = _u32_at(serdata + size_at).value + _HEADER_BYTES
                        self._pending_bytes += length
                        pending.append((serdata, length, stamp, source_stamp, identity))
                        continue
                unref(serdata)
        samples, size = self._pump.space()
        batch: list[Sample] = []
        handed = 0
        type, order, header_at = self.type, self._order, lib.header_at
        while pending and samples > 0 and size > 0:
            serdata, length, stamp, source_stamp, identity = pending.popleft()
            if length < _COPY_WITHOUT_GIL_BYTES:
                payload = _new_bytes(serdata + header_at, length)
            else:
                payload = _new_bytes(None, length)
                lib.serdata_to_ser(serdata, 0, length, _address_of(payload))
            unref(serdata)
            if payload[_OPTIONS_AT]:
                payload = without_padding(payload)
            handed += length
            size -= length
            samples -= 1
            if order is not None and order.big.get(identity.guid) is not False:
                native = order.native(identity.guid, payload)
                if native is None:
                    self._drops[Undelivered.DECODE] += 1
                    continue
                payload = native
            seq = source_stamp if source_stamp > 0 else SEQ_NONE
            batch.append(Sample(payload, type, stamp, identity.guid, seq, identity.relayed))
        self._pending_bytes -= handed
        if batch:
            self._pump.push(self._deliver, batch, len(batch), handed)
        if self._drops and self._pump.room:
            self._pump.push(self._dropped, list(self._drops.items()))
            self._drops.clear()
        if pending:
            self._trim(pending)
            self._pump.again(self.on_data)

    def discard(self) -> None:
        """Let go of what waits; in the pump's thread."""
        self.closed = True
        while self._pending:
            lib.serdata_unref(self._pending.popleft()[0])
        self._pending_bytes = 0

    def _trim(self, pending: deque[tuple[int, int, int, int, WriterIdentity]]) -> None:
        depth = self._depth
        while (depth is not None and len(pending) > depth) or (
            self._pending_bytes > _PENDING_LIMIT_BYTES and len(pending) > 1
        ):
            serdata, length, *_ = pending.popleft()
            lib.serdata_unref(serdata)
            self._pending_bytes -= length
            self._drops[Undelivered.BACKLOG] += 1


class RawWriter:
    """Writes serialised samples: at once from the loop, big ones in the courier's thread, all in order.

    Of what waits for the courier the newest ``depth`` (and 256 MB) survive; ``refused`` gets the reason of each one
    that was given to ``write`` and not sent. A ``depth`` of ``None`` keeps the oldest instead.
    """

    def __init__(
        self,
        participant: ParticipantHost,
        topic: tuple[str, str],
        entity: int,
        sertype: int,
        depth: int | None,
        refused: Callable[[Undelivered], None],
    ) -> None:
        self.topic, self.entity = topic, entity
        self.guid = b""
        self.closed = False
        self.key = 0
        self.matches: Matches | None = None
        self._sertype = sertype
        self._courier = participant.courier
        self._depth = depth
        self._refused = refused
        self._vector = IoVec()
        self._unflushed = False
        self._loop = asyncio.get_running_loop()
        self._waiting: deque[tuple[bytes, int]] | None = None  # most writers have nothing for the courier
        self._in_count = self._in_bytes = 0  # changed by the loop alone
        self._out_count = self._out_bytes = 0  # changed by the courier alone

    @property
    def busy(self) -> bool:
        """Whether the writer thread still holds samples of this writer."""
        return self._in_count != self._out_count

    def write(self, payload: bytes, source_stamp_ns: int = 0, *, in_turn: bool = True) -> Undelivered | None:
        """Send CDR bytes with their header; return why they were not sent.

        ``source_stamp_ns`` is sent as the source timestamp; 0 sends the time of now. Without ``in_turn`` they go before
        what waits for the courier, ``refused`` is not told, and nothing is flushed.
        """
        length = len(payload)
        if in_turn and (self.closed or length >= _COURIER_BYTES or self._in_count != self._out_count):
            self._later(bytes(payload), source_stamp_ns)
            return None
        if payload.__class__ is not bytes:
            payload = bytes(payload)
        vector = self._vector
        vector.base, vector.len = payload, length
        if length < _COPY_WITHOUT_GIL_BYTES:
            serdata = lib.serdata_from_ser_iov(self._sertype, SERDATA_DATA, 1, _byref(vector), length)
        else:
            serdata = lib.serdata_from_ser_iov_nogil(self._sertype, SERDATA_DATA, 1, _byref(vector), length)
            vector.base = None  # what was big is not kept until the next write
        if serdata:
            if length & 3 or payload[_OPTIONS_AT]:
                tell_padding(serdata, length)
            if 0 < source_stamp_ns <= _MAX_STAMP:
                _i64_at(serdata + lib.timestamp_at).value = source_stamp_ns
                code = lib.forwardcdr(self.entity, serdata)  # either takes the reference over
            else:
                code = lib.writecdr(self.entity, serdata)
            reason = None if code >= 0 else Undelivered.WRITE
        else:
            reason = Undelivered.ENCODE
        if in_turn:
            if reason is not None:
                self._refused(reason)
            elif not self._unflushed:
                self._unflushed = True
                self._loop.call_soon(self._flush)
        return reason

    def _later(self, payload: bytes, source_stamp_ns: int) -> None:
        if self.closed:
            self._refused(Undelivered.CLOSED)
        else:
            self._enqueue(payload, source_stamp_ns)

    def sends_at_once(self, size: int) -> bool:
        """Return whether a sample of ``size`` bytes can be sent without the writer thread."""
        return size < _COURIER_BYTES and self._in_count == self._out_count and not self.closed

    def send_at_once(self, payload: bytes) -> Undelivered | None:
        """Send without the writer thread, where ``sends_at_once`` says so; return why it was not sent."""
        reason = self.write(payload, in_turn=False)
        if reason is None and not self._unflushed:  # the first goes at once, others of this turn go together
            self._unflushed = True
            lib.write_flush(self.entity)
            self._loop.call_soon(self._flush)
        return reason

    async def send(self, payload: bytes) -> Undelivered | None:
        """Send like ``write``, and tell what became of it: ``None``, or why it was not sent."""
        if self.closed:
            return Undelivered.CLOSED
        if self.sends_at_once(len(payload)):
            return self.send_at_once(payload)
        if self._in_bytes - self._out_bytes > _PENDING_LIMIT_BYTES:
            return Undelivered.WRITE
        done: asyncio.Future[Undelivered | None] = self._loop.create_future()
        self._in_count += 1
        self._in_bytes += len(payload)

        def errand() -> None:
            reason = self.write(payload, in_turn=False)
            lib.write_flush(self.entity)
            self._out_bytes += len(payload)
            self._out_count += 1
            with contextlib.suppress(RuntimeError):  # the loop closed first
                self._loop.call_soon_threadsafe(_resolve, done, reason)

        self._courier.submit(errand)
        return await done

    def _flush(self) -> None:
        self._unflushed = False
        if not self.closed:
            lib.write_flush(self.entity)  # what shares a datagram that is not full

    def _enqueue(self, payload: bytes, source_stamp_ns: int) -> None:
        waiting = self._waiting
        if waiting is None:
            waiting = self._waiting = deque()
        if self._depth is None:
            if waiting and self._in_bytes - self._out_bytes > _PENDING_LIMIT_BYTES:
                self._refused(Undelivered.WRITE)
                return
        else:
            while len(waiting) >= self._depth or self._in_bytes - self._out_bytes > _PENDING_LIMIT_BYTES:
                try:
                    oldest, _ = waiting.popleft()
                except IndexError:  # the courier took it
                    break
                self._in_count -= 1
                self._in_bytes -= len(oldest)
                self._refused(Undelivered.WRITE)
        waiting.append((payload, source_stamp_ns))
        self._in_count += 1
        self._in_bytes += len(payload)
        loop = asyncio.get_running_loop()
        self._courier.submit(lambda: self._write_next(waiting, loop))

    def _write_next(self, waiting: deque[tuple[bytes, int]], loop: asyncio.AbstractEventLoop) -> None:
        """Write the next waiting sample; runs in the writer thread."""
        try:
            payload, source_stamp_ns = waiting.popleft()
        except IndexError:  # a newer one took its place
            return
        reason = self.write(payload, source_stamp_ns, in_turn=False)
        lib.write_flush(self.entity)
        self._out_bytes += len(payload)
        self._out_count += 1
        if reason is not None:
            with contextlib.suppress(RuntimeError):  # the loop closed first
                loop.call_soon_threadsafe(self._refused, reason)


def _resolve(done: asyncio.Future[Undelivered | None], reason: Undelivered | None) -> None:
    if not done.done():
        done.set_result(reason)


def without_padding(payload: bytes) -> bytes:
    """Return the message as it was written: its header's options tell how many bytes the network adds to
    fill up four.
    """
    end = len(payload)
    if end % 4 == 0:  # within a process nothing is added
        end = max(end - (payload[_OPTIONS_AT] & 3), _HEADER_BYTES)
    return b"".join((payload[:2], _NO_OPTIONS, payload[_HEADER_BYTES:end]))


def tell_padding(serdata: int, length: int) -> None:
    """Write into the header of a new sample of ``length`` bytes how many zero bytes DDS adds to fill up four.

    The library would refuse a sample that is told so and is not filled up yet, where its body has but a byte or two.
    """
    padding = -length & 3
    _u8_at(serdata + lib.header_at + _OPTIONS_AT).value = padding
    ct.memset(serdata + lib.header_at + length, 0, padding)
