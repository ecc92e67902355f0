"""The self-test: calls to ourselves, through the network, that nobody sees.

Two participants of this process meet on the loopback interface, in a domain of their own behind a tag that is made up
for the occasion. One serves, the other calls; requests and replies carry their identities as they would to and from
Fast DDS, once under each of the two parameter ids, in one datagram and in many.
"""

from __future__ import annotations

import os
import queue
import time
from typing import Final

from ropeway.errors import GraphUnavailable
from ropeway.networks.dds.fastdds import serdata_hook as hook
from ropeway.networks.dds.fastdds.early_reader import check_layout
from ropeway.networks.dds.fastdds.frames import HelperFrame, Op, Spec
from ropeway.networks.dds.fastdds.identity import PID_RELATED, PID_RELATED_OLD, SampleIdentity
from ropeway.networks.dds.fastdds.node import FastNode
from ropeway.networks.dds.fastdds.serdata_hook import HookError
from ropeway.networks.dds.fastdds.service_endpoints import ClientEnd, ServiceEnd
from ropeway.networks.dds.profile import Profile
from ropeway.networks.dds.raw import DdsError

__all__ = ["wrong"]

_SPEC: Final = Spec("/ropeway/self_test", "ropeway/srv/SelfTest")
_NUMBERS: Final = (230, 231)  # two domains to this process …
_NUMBER: Final = 231  # … and one to the network
_LIMIT_S: Final = 20.0  # a second is usual; what fails once fails for good, also where a machine was busy
_AGAIN_S: Final = 0.05
_SIZES: Final = (1, 100, 30_000)


def wrong() -> str:
    """Return what is wrong, or ``""`` if everything works; takes some seconds at most."""
    try:
        return _Call().run()
    except (HookError, DdsError, GraphUnavailable) as error:
        return str(error)


class _Call:
    def __init__(self) -> None:
        self._asked: queue.SimpleQueue[HelperFrame] = queue.SimpleQueue()
        self._told: queue.SimpleQueue[HelperFrame] = queue.SimpleQueue()
        self._failed = ""
        self._calls = 0
        self._past: set[bytes] = set()  # requests that were sent more than once may still come
        self._until = time.monotonic() + _LIMIT_S

    def run(self) -> str:
        profile = Profile(_xml(os.urandom(8).hex()))
        server = FastNode(_NUMBERS[0], profile, "", self._asked.put, self._fail, everyone=True)
        try:
            check_layout(server.participant)
            client = FastNode(_NUMBERS[1], profile, "", self._told.put, self._fail, everyone=True)
            try:
                fault = self._meet(server, client)
                return self._failed or fault
            finally:
                client.close()
        finally:
            server.close()

    def _fail(self, error: Exception) -> None:
        self._failed = f"{type(error).__name__}: {error}"
        self._until = 0.0

    def _meet(self, server: FastNode, client: FastNode) -> str:
        server.open(1, _SPEC, serves=True)
        client.open(1, _SPEC, serves=False)
        if not (all(self._next(frames, Op.MATCHED, _LIMIT_S) for frames in (self._told, self._asked))):
            return "two participants on the loopback interface do not find each other"
        for parameter in (PID_RELATED, PID_RELATED_OLD):
            for size in _SIZES:
                if fault := self._exchange(server, client, parameter, size):
                    return f"{fault} (parameter {parameter:#06x}, {size} bytes)"
        return ", ".join(hook.faults)

    def _exchange(self, server: FastNode, client: FastNode, parameter: int, size: int) -> str:
        """Make one call; each side must see the identities that the other knows from the library itself. The other side
        must see the very identities that this side knows from the library itself.
        """
        request, response = (b"\0\1\0\0" + os.urandom(size) for _ in range(2))
        asked = None
        sent: dict[bytes, int] = {}
        while asked is None:  # Cyclone DDS does not hear what another one says in the first moment
            if hook.faults or time.monotonic() > self._until:
                return "a request does not arrive"
            with client.end(1) as asks:
                assert isinstance(asks, ClientEnd)
                self._calls += 1
                asks.call(self._calls, request, parameter)
                writer, reader = asks.writer.guid, asks.reader_guid
                sent[writer + asks.last.to_bytes(8, "little") + request] = asks.last
            asked = self._next(self._asked, Op.REQUEST, _AGAIN_S)
            while asked is not None and asked.body in self._past:
                asked = self._next(self._asked, Op.REQUEST, _AGAIN_S)
            if asked is not None and asked.body not in sent:
                return "a request does not tell where it came from"
        self._past.update(sent)
        with server.end(1) as serves:
            assert isinstance(serves, ServiceEnd)
            if serves.asked(asked.number) != (parameter, SampleIdentity(reader, sent[asked.body])):
                return "a request does not tell who waits for the reply"
            serves.reply(asked.number, response)
        told = self._next(self._told, Op.RESPONSE, _LIMIT_S)
        if told is None:
            return "a reply does not arrive"
        return "" if told.body == response else "a reply is another one"

    def _next(self, frames: queue.SimpleQueue[HelperFrame], op: Op, timeout_s: float) -> HelperFrame | None:
        until = min(self._until, time.monotonic() + timeout_s)
        try:
            while (frame := frames.get(timeout=max(0.0, until - time.monotonic()))).op != op:
                if frame.op == Op.REFUSED:
                    self._failed = frame.body.decode()
                    return None
        except queue.Empty:
            return None
        return frame


def _xml(tag: str) -> str:
    return (
        '<CycloneDDS><Domain id="any"><General><Interfaces><NetworkInterface name="lo"/></Interfaces>'
        "<AllowMulticast>false</AllowMulticast>"
        "<MaxMessageSize>8192B</MaxMessageSize><FragmentSize>8000B</FragmentSize></General>"
        f"<Discovery><ExternalDomainId>{_NUMBER}</ExternalDomainId><Tag>{tag}</Tag>"
        "<ParticipantIndex>auto</ParticipantIndex><MaxAutoParticipantIndex>99</MaxAutoParticipantIndex>"
        '<Peers><Peer Address="127.0.0.1"/></Peers></Discovery></Domain></CycloneDDS>'
    )
