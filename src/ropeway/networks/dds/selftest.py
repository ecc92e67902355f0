"""The self-test of the raw path: every memory layout it assumes, against the library that is there."""

from __future__ import annotations

import ctypes as ct

from ropeway.errors import GraphUnavailable
from ropeway.networks.dds import library, raw
from ropeway.networks.dds.raw import check, lib

__all__ = ["choose_layout", "verify"]

_state: dict[str, bool] = {"verified": False}


def verify(graph: str, participant: int, sertype: int) -> None:
    """Check every memory layout this module assumes, once per process, without a packet on the network.

    Raises ``GraphUnavailable`` with what differs.
    """
    if _state["verified"]:
        return
    choose_layout(graph, sertype)
    if wrong := _wrong_info(participant):
        raise _unknown(graph, wrong)
    _state["verified"] = True


def choose_layout(graph: str, sertype: int) -> None:
    """Have samples read and written in the known layout that fits. Raises ``GraphUnavailable`` if none does."""
    wrong: list[str] = []
    for layout in library.LAYOUTS:
        fault = _wrong_serdata(sertype, layout)
        if not fault:
            lib.use(layout)
            return
        wrong.append(f"{layout.version}: {fault}")
    raise _unknown(graph, "; ".join(wrong))


def _unknown(graph: str, wrong: str) -> GraphUnavailable:
    return GraphUnavailable(
        graph,
        f"{lib.name} is not a build of Cyclone DDS that Ropeway knows ({wrong}); docs/install.md lists those",
    )


def _wrong_serdata(sertype: int, layout: library.Layout) -> str:
    for payload in (b"\0\1\0\0\x07", b"\0\1\0\0" + bytes(range(256)) * 5):
        serdata = raw.make_serdata(sertype, payload)
        if not serdata:
            return "a serialised sample is refused"
        try:
            if lib.serdata_size(serdata) != len(payload):
                return "serdata size"
            if ct.c_uint32.from_address(serdata + layout.size).value != len(payload) - 4:
                return "serdata size offset"
            out = raw.IoVecOut()
            ref = lib.serdata_to_ser_ref(serdata, 0, len(payload), ct.byref(out))
            same = out.base == serdata + layout.header and ct.string_at(out.base, len(payload)) == payload
            lib.serdata_to_ser_unref(ref, ct.byref(out))
            if not same:
                return "serdata payload offset"
            if ct.c_int64.from_address(serdata + layout.timestamp).value != -(2**63):
                return "serdata timestamp offset"
        finally:
            lib.serdata_unref(serdata)
    if raw.make_serdata(sertype, b"\0\1") or raw.make_serdata(sertype, b"\x12\x34\0\0\0"):
        return "bytes that are not CDR are accepted"
    return ""


def _wrong_info(participant: int) -> str:
    reader = check(lib.create_reader(participant, raw.BUILTIN_PARTICIPANT, None, None), "create builtin reader")
    try:
        own = raw.handle_of(participant)
        samples, infos = (ct.c_uint64 * 64)(), (raw.SampleInfo * 64)()
        view = memoryview(infos).cast("B")
        while True:
            samples[0] = 0
            count = check(lib.take(reader, samples, infos, 64, 64), "take builtin topic")
            if not count:
                return "builtin topics"
            try:
                for address, (state, valid, stamp, instance, _) in zip(
                    samples[:count], raw.INFO.iter_unpack(view[: count * raw.INFO.size]), strict=True
                ):
                    if instance == own:
                        key = bytes(raw.ParticipantData.from_address(address).key)
                        fits = state == raw.ALIVE and valid and stamp > 0 and key == raw.guid_of(participant)
                        return "" if fits else "sample info"
            finally:
                lib.return_loan(reader, samples, count)
    finally:
        lib.delete(reader)
