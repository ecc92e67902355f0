"""A peer that speaks DDS through the classes of cyclonedds, with type information, as an ordinary DDS program does.

Its library is that of the wheel. Where ours is another, both meet on the network.
"""

import contextlib
import os
from dataclasses import dataclass
from typing import Any

import pytest

from ropeway.networks.dds import library
from ropeway.networks.dds.profile import make_profile

pytest.importorskip("cyclonedds", reason="there is no wheel of cyclonedds")

from cyclonedds.core import DDSException
from cyclonedds.domain import Domain, DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
BEST_EFFORT = Policy.Reliability.BestEffort
LATCHED = (RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))


SEPARATE = bool(os.environ.get(library.ENVIRONMENT))
"""Whether our library is another than the wheel's."""


@dataclass
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
class Foreign(IdlStruct, typename="company.Foreign"):
    value: str


class Peer:
    """One participant; ``enclave`` is in its USER_DATA as ROS has it."""

    def __init__(self, domain: int) -> None:
        self._domain: Any = None
        if SEPARATE:
            with contextlib.suppress(DDSException):  # another peer has made it
                self._domain = Domain(domain, make_profile("peer", "lo").xml)
        self.participant = DomainParticipant(domain, qos=Qos(Policy.Userdata(b"enclave=/;")))
        self._parts: list[Any] = []

    def writer(self, topic: str, *policies: Any, type: type = String) -> Any:
        policies = policies or (RELIABLE, Policy.History.KeepLast(10))
        writer: Any = DataWriter(self.participant, Topic(self.participant, topic, type), Qos(*policies))
        self._parts.append(writer)
        return writer

    def reader(self, topic: str, *policies: Any, type: type = String) -> Any:
        policies = policies or (RELIABLE, Policy.History.KeepLast(10))
        reader: Any = DataReader(self.participant, Topic(self.participant, topic, type), Qos(*policies))
        self._parts.append(reader)
        return reader

    def texts(self, reader: Any) -> list[str]:
        return [sample.data for sample in reader.take(100) if isinstance(sample, String)]
