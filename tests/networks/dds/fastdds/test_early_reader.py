"""ropeway.networks.dds.fastdds.early_reader: readers that take what came before their writer was found."""

from __future__ import annotations

import os
from collections.abc import Iterator

import pytest

from ropeway.networks.dds import raw
from ropeway.networks.dds.endpoint_qos import reader_qos
from ropeway.networks.dds.fastdds.early_reader import check_layout, take_early
from ropeway.networks.dds.fastdds.serdata_hook import HookError
from ropeway.networks.dds.raw import check, lib
from ropeway.qos import QoS

DOMAIN = 60 + os.getpid() % 20


@pytest.fixture
def participant() -> Iterator[int]:
    """A participant of the library itself."""
    raw.load("test")
    entity = check(lib.create_participant(DOMAIN, None, None), "create participant")
    yield entity
    lib.delete(entity)


def made(participant: int, qos: QoS) -> tuple[int, int]:
    """Return a new reader and its type."""
    topic, sertype = raw.create_topic(participant, "rt/early", "std_msgs::msg::dds_::String_")
    with reader_qos(qos, b"") as handle:
        return check(lib.create_reader(participant, topic, handle, None), "create reader"), sertype


def test_the_layout_of_this_library(participant: int) -> None:
    """The flag is where it is looked for, in the library that the tests run with; looking leaves nothing behind."""
    check_layout(participant)
    check_layout(participant)


def test_is_done_once(participant: int) -> None:
    """A volatile reader is made to take early samples once; what has the flag already is no volatile reader."""
    reader, sertype = made(participant, QoS())
    take_early(reader, sertype)
    with pytest.raises(HookError, match="wants a history"):
        take_early(reader, sertype)


def test_readers_of_other_kinds(participant: int) -> None:
    """A reader that wants a history, and one that acknowledges nothing, are refused."""
    reader, sertype = made(participant, QoS(durability="transient_local"))
    with pytest.raises(HookError, match="wants a history"):
        take_early(reader, sertype)
    reader, sertype = made(participant, QoS(reliability="best_effort"))
    with pytest.raises(HookError, match="not where they should be"):
        take_early(reader, sertype)
