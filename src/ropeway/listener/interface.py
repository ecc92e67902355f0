"""Dials by one of several network interfaces, whatever the routes of the system say."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import ipaddress
import socket
from typing import Final

__all__ = ["dial_by"]

_TO_DEVICE: Final[int | None] = getattr(socket, "SO_BINDTODEVICE", None)  # Linux


async def dial_by(interface: str, host: str, port: int) -> socket.socket:
    """Return a socket that is connected to a host by an interface: its name (``wlan0``), or an address that it has.

    Raises ``OSError``.
    """
    loop = asyncio.get_running_loop()
    found = await loop.getaddrinfo(host, port, type=socket.SOCK_STREAM)
    error: OSError = OSError(errno.EHOSTUNREACH, f"{host} has no address that {interface} can reach")
    for family, kind, protocol, _, address in found:
        source = _source(interface, family)
        if source == "":
            continue
        made = socket.socket(family, kind, protocol)
        try:
            made.setblocking(False)
            if source is None:
                _bind_to(made, interface)
            else:
                made.bind((source, 0))
            await loop.sock_connect(made, address)
        except OSError as failed:
            made.close()
            error = failed
        except BaseException:
            made.close()
            raise
        else:
            return made
    raise error


def _source(interface: str, family: int) -> str | None:
    """Return the address to bind to, ``None`` where it is the name of an interface, ``""`` if of another family."""
    with contextlib.suppress(ValueError):
        version = ipaddress.ip_address(interface).version
        return interface if (version == 6) == (family == socket.AF_INET6) else ""
    return None


def _bind_to(made: socket.socket, interface: str) -> None:
    if _TO_DEVICE is None:
        raise OSError(errno.ENOTSUP, f"this system binds no socket to {interface}; write the interface's address")
    try:
        made.setsockopt(socket.SOL_SOCKET, _TO_DEVICE, interface.encode())
    except PermissionError:
        raise OSError(errno.EPERM, f"no right to bind to {interface}; write the interface's address") from None
    except OSError as error:
        raise OSError(error.errno, f"there is no interface {interface}") from error
