"""ropeway.networks.mqtt.wire: what goes beside a payload."""

from __future__ import annotations

from paho.mqtt.client import MQTTMessage

from ropeway.graph.base import Sample
from ropeway.networks.mqtt.wire import PublishProperties, read_message
from tests.support.messages import STRING


def message(payload: bytes = b"x", properties: object = None, topic: bytes = b"t") -> MQTTMessage:
    made = MQTTMessage(1, topic)
    made.payload, made.properties = payload, properties  # type: ignore[assignment]
    return made


def test_identity() -> None:
    """A message tells who published it first, its number, its type, and whether it is CDR."""
    sample = Sample(b"x", STRING, 1, b"o" * 16, 1234)
    for form in ("cdr", "json", "floats"):
        found = read_message(message(properties=PublishProperties(STRING, form, 0.2).of(sample)), "broker")
        assert found is not None
        assert (found.origin, found.seq, found.type, found.told) == (b"o" * 16, 1234, STRING, True)
        assert found.form == ("cdr" if form == "cdr" else "")
    assert PublishProperties(STRING, "cdr", 0.2).of(sample).MessageExpiryInterval == 1
    assert PublishProperties(STRING, "cdr", 1e30).of(sample).MessageExpiryInterval == 2**32 - 1


def test_of_strangers() -> None:
    """A message without an identity, or with a false one, has that of its topic."""
    plain = read_message(message(), "broker")
    assert plain is not None
    assert (plain.type, plain.told, len(plain.origin)) == ("", False, 16)
    for value in ("", "x" * 400, "0" * 32 + " 0 a", "g" * 32 + " 1 a", "0" * 32 + " 1" + "0" * 30 + " a"):
        false = PublishProperties(STRING, "text", None).of(Sample(b"", STRING, 1, bytes(16), 1))
        del false.UserProperty
        false.UserProperty = [("ropeway", value), ("other", "x")]
        found = read_message(message(properties=false), "broker")
        assert found is not None
        assert found.seq


def test_names_that_are_no_text() -> None:
    """A message whose topic is no UTF-8 text is none."""
    assert read_message(message(topic=b"\xff\xfe"), "broker") is None


def test_repeated() -> None:
    """A value is the same again by its identity, or by its payload where nobody tells one."""
    first, second, other = read_message(message(), "b"), read_message(message(), "b"), read_message(message(b"y"), "b")
    assert first is not None
    assert second is not None
    assert other is not None
    assert first.repeats(second)
    assert not first.repeats(other)
    assert not first.repeats(None)
