"""The helper's participant: one thread waits for DDS, the other one carries out what the gateway asks."""

from __future__ import annotations

import ctypes as ct
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import Final

from ropeway.errors import RopewayError
from ropeway.graph.base import Undelivered
from ropeway.networks.dds import domain, raw
from ropeway.networks.dds.endpoint_qos import user_data
from ropeway.networks.dds.fastdds import serdata_hook as hook
from ropeway.networks.dds.fastdds.discovery import Census
from ropeway.networks.dds.fastdds.frames import HelperFrame, Op, Spec
from ropeway.networks.dds.fastdds.identity import FAST
from ropeway.networks.dds.fastdds.serdata_hook import HookError
from ropeway.networks.dds.fastdds.service_endpoints import ClientEnd, ServiceEnd
from ropeway.networks.dds.profile import Profile
from ropeway.networks.dds.raw import INFINITY, DdsError, check, lib
from ropeway.networks.dds.vendors import HELPER_MARK

__all__ = ["FastNode"]

_TICK_NS: Final = 20_000_000  # between two looks at what waits
_MAX_TRIGGERS: Final = 256
_GUARD_KEY: Final = 0
_KEYS: Final = 4  # per endpoint: its data, the matches of its reader and of its writer

Emit = Callable[[HelperFrame], None]


class FastNode:
    """A participant for endpoints of this kind, in domain ``number``.

    ``gateway_id`` marks its endpoints. ``emit`` gets frames for the gateway, in whichever thread is at work;
    ``fail`` is called when the one that waits for DDS has failed. ``everyone`` hears other vendors than Fast DDS, too.
    Raises ``DdsError``, ``GraphUnavailable``, ``HookError``.
    """

    def __init__(
        self,
        number: int,
        profile: Profile,
        gateway_id: str,
        emit: Emit,
        fail: Callable[[Exception], None],
        *,
        everyone: bool = False,
    ) -> None:
        self.lock = threading.Lock()
        self.gateway_id = gateway_id
        self.emit = emit
        self._fail = fail
        self._number, self._everyone = number, everyone
        self._ends: dict[int, ClientEnd | ServiceEnd] = {}
        self._census: Census | None = None
        self._held: dict[int, Spec] = {}
        self._drops: Counter[tuple[int, Undelivered]] = Counter()
        self._stopping = False
        domain.acquire("dds", number, profile)
        try:
            qos, mark = lib.create_qos(), f"{HELPER_MARK}=1;".encode()
            lib.qset_userdata(qos, mark, len(mark))
            entity: int = lib.create_participant(number, qos, None)
            lib.delete_qos(qos)
            self.participant = check(entity, "create participant")
        except BaseException:
            domain.release(number)
            raise
        try:
            self.guid = raw.guid_of(self.participant)
            self._waitset = check(lib.create_waitset(self.participant), "create_waitset")
            self._guard = check(lib.create_guardcondition(self.participant), "create_guardcondition")
            check(lib.waitset_attach(self._waitset, self._guard, _GUARD_KEY), "waitset_attach")
            self._thread = threading.Thread(target=self._main, name="ropeway fast", daemon=True)
            self._thread.start()
        except BaseException:
            lib.delete(self.participant)
            domain.release(number)
            raise

    def close(self) -> None:
        """Leave the domain with all endpoints."""
        self._stopping = True
        self.wake()
        self._thread.join()
        for end in self._ends.values():
            end.close()
        self._ends.clear()
        lib.delete(self.participant)
        domain.release(self._number)

    def hears(self, vendor: bytes) -> bool:
        """Return whether the vendor uses this mapping."""
        return self._everyone or vendor == FAST

    def count(self, number: int, reason: Undelivered) -> None:
        """Count a request or reply of an endpoint that was lost, with the reason."""
        self._drops[number, reason] += 1

    def tell_drops(self) -> None:
        """Emit what was counted since the last time, and what the hook could not do."""
        with self.lock:
            for (number, reason), count in self._drops.items():
                self.emit(HelperFrame(Op.DROPPED, number, count, reason.name.encode()))
            self._drops.clear()
            for text in list(hook.faults):
                self.emit(HelperFrame(Op.FAULTS, 0, hook.faults.pop(text), text.encode()))

    # Endpoints --------------------------------------------------------------------------------------------------

    def mark_of(self, type_hash: str) -> bytes:
        """Return the USER_DATA of an endpoint whose messages have this hash (``""``: unknown)."""
        return user_data(type_hash=type_hash, gateway_id=self.gateway_id, extra=f"{HELPER_MARK}=1;")

    def expect(self, guids: Iterable[bytes]) -> None:
        """Make services that are opened from now on wait until these endpoints are found."""
        with self.lock:
            self._census = Census(self.participant, guids)
        self.wake()

    def open(self, number: int, spec: Spec, *, serves: bool) -> None:
        """Make an endpoint and give it a number; emits why where it cannot be made."""
        with self.lock:
            if serves and self._census is not None:
                self._held[number] = spec
            else:
                self._open(number, spec, serves=serves)

    def _open(self, number: int, spec: Spec, *, serves: bool) -> None:
        try:
            self._ends[number] = (ServiceEnd if serves else ClientEnd)(self, number, spec)
        except (DdsError, HookError, RopewayError) as error:
            self.emit(HelperFrame(Op.REFUSED, number, body=str(error).encode()))

    def shut(self, number: int) -> None:
        """Remove an endpoint."""
        with self.lock:
            self._held.pop(number, None)
            end = self._ends.pop(number, None)
            if end is not None:
                end.close()

    @contextmanager
    def end(self, number: int) -> Iterator[ClientEnd | ServiceEnd | None]:
        """Return an endpoint, under the lock; ``None`` if there is none with this number."""
        with self.lock:
            yield self._ends.get(number)

    def attach(self, number: int, reader: int, writer: int) -> None:
        """Wait for the data and the matches of an endpoint, too."""
        condition = check(lib.create_readcondition(reader, raw.ANY_STATE), "create_readcondition")
        check(lib.set_status_mask(reader, raw.SUBSCRIPTION_MATCHED), "set_status_mask")
        check(lib.set_status_mask(writer, raw.PUBLICATION_MATCHED), "set_status_mask")
        for offset, entity in enumerate((condition, reader, writer), start=1):
            check(lib.waitset_attach(self._waitset, entity, number * _KEYS + offset), "waitset_attach")
        self.wake()

    def wake(self) -> None:
        """Wake the thread."""
        check(lib.set_guardcondition(self._guard, True), "set_guardcondition")

    def _main(self) -> None:
        try:
            self._run()
        except Exception as error:  # of the library, or of ours: whoever waits for the node learns of it
            self._fail(error)

    def _run(self) -> None:
        triggers = (ct.c_ssize_t * _MAX_TRIGGERS)()
        was_set = ct.c_bool()
        while not self._stopping:
            timeout = _TICK_NS if self._waits() else INFINITY
            count = check(lib.waitset_wait(self._waitset, triggers, _MAX_TRIGGERS, timeout), "waitset_wait")
            for key in triggers[: min(count, _MAX_TRIGGERS)]:
                if key == _GUARD_KEY:
                    check(lib.take_guardcondition(self._guard, ct.byref(was_set)), "take_guardcondition")
                    continue
                number, offset = divmod(key, _KEYS)
                with self.lock:
                    end = self._ends.get(number)
                    if end is not None and offset == 1:
                        end.on_data()
                    elif end is not None:
                        end.on_matches()
            with self.lock:
                self._tick()

    def _waits(self) -> bool:
        with self.lock:
            return self._census is not None or any(end.waits for end in self._ends.values())

    def _tick(self) -> None:
        if self._census is not None and self._census.complete():
            self._census = None
            for number, spec in self._held.items():
                self._open(number, spec, serves=True)
            self._held.clear()
        for end in self._ends.values():
            if end.waits:
                end.tick()
