"""Ports of the loopback interface that nobody uses now."""

from __future__ import annotations

import socket

__all__ = ["free_endpoint", "free_port", "free_udp_port"]


def free_port() -> int:
    """Return a TCP port that nobody listens on."""
    return _free(socket.SOCK_STREAM)


def free_udp_port() -> int:
    """Return a UDP port that nobody reads."""
    return _free(socket.SOCK_DGRAM)


def free_endpoint() -> str:
    """Return a Zenoh endpoint that nobody listens on."""
    return f"tls/127.0.0.1:{free_port()}"


def _free(kind: socket.SocketKind) -> int:
    with socket.socket(socket.AF_INET, kind) as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port
