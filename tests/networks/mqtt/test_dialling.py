"""ropeway.networks.mqtt.dialling: why a broker is not reached, in words."""

from __future__ import annotations

import socket
import ssl

import pytest

from ropeway.networks.mqtt.dialling import ConnectionPlan, advice, dial, reason_of
from tests.support.ports import free_port


@pytest.mark.parametrize(
    ("error", "said"),
    [
        (ConnectionRefusedError(111, "Connection refused"), "cannot be reached: Connection refused"),
        (socket.gaierror(-2, "Name or service not known"), "cannot be reached: Name or service not known"),
        (TimeoutError(), "did not answer within 5 s"),
        (ssl.SSLError(1, "wrong version"), "TLS with the broker failed"),
        (ssl.SSLCertVerificationError(1, "x"), "name its authority as ca"),
        (UnicodeError("label too long"), "cannot be spoken to: label too long"),
    ],
)
def test_reasons(error: Exception, said: str) -> None:
    """Every failure has a reason that says what to look at."""
    assert said in reason_of(error)


def test_advice() -> None:
    """A refusal says what to do, where that is known."""
    assert "password" in advice("Not authorized")
    assert "password" in advice("Bad user name or password")
    assert "version=3.1.1" in advice("Unsupported protocol version")
    assert advice("Server busy") == ""


@pytest.mark.parametrize("version", ["5", "3.1.1"])
async def test_nobody(version: str) -> None:
    """A broker that is not there is an error of the system."""
    with pytest.raises(OSError, match="refused"):
        await dial(ConnectionPlan("127.0.0.1", free_port(), "x", "user", "word", version=version, will_topic="w"))
