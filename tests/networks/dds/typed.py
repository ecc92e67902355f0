"""A peer that speaks DDS through the classes of cyclonedds, with type information, as an ordinary DDS program does."""

from dataclasses import dataclass
from typing import Any

from cyclonedds.domain import DomainParticipant
from cyclonedds.idl import IdlStruct
from cyclonedds.pub import DataWriter
from cyclonedds.qos import Policy, Qos
from cyclonedds.sub import DataReader
from cyclonedds.topic import Topic
from cyclonedds.util import duration

RELIABLE = Policy.Reliability.Reliable(duration(seconds=1))
BEST_EFFORT = Policy.Reliability.BestEffort
LATCHED = (RELIABLE, Policy.Durability.TransientLocal, Policy.History.KeepLast(1))


@dataclass
class String(IdlStruct, typename="std_msgs.msg.dds_.String_"):
    data: str


@dataclass
class Foreign(IdlStruct, typename="company.Foreign"):
    value: str


class Peer:
    """One participant; ``enclave`` is in its USER_DATA as ROS has it."""

    def __init__(self, domain: int) -> None:
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
