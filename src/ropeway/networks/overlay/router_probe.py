"""Finds out why a router cannot be reached, by trying a connection, since Zenoh does not say."""

from __future__ import annotations

import asyncio
import os
import re
import socket
import ssl
from collections.abc import Sequence
from typing import Final

from cryptography.hazmat.primitives.serialization import Encoding

from ropeway import aio
from ropeway.networks.overlay.crypto.identity import Identity

__all__ = ["unreachable"]

_TLS: Final = re.compile(r"tls/(?:\[(?P<six>[^\]]+)\]|(?P<four>[^:]+)):(?P<port>\d+)")
_PATIENCE_S: Final = 3.0


async def unreachable(identity: Identity, routers: Sequence[str]) -> str:
    """Return, in one sentence, why none of the routers is linked with the owner of ``identity``."""
    if not routers:
        return "no router is known: name one under overlay.routers, or have a bundle issued with --connect"
    reasons = await asyncio.gather(*(_reason(identity, router) for router in routers))
    return "no router can be reached: " + "; ".join(
        f"{router}: {reason}" for router, reason in zip(routers, reasons, strict=True)
    )


async def _reason(identity: Identity, router: str) -> str:
    match = _TLS.fullmatch(router)
    if match is None:
        return "no answer"
    context = ssl.create_default_context(cadata=identity.ca.public_bytes(Encoding.PEM).decode())
    context.verify_flags &= ~ssl.VERIFY_X509_STRICT  # of Python 3.13; Zenoh asks for less
    context.check_hostname = False  # names say nothing about place, here as in Zenoh
    try:
        async with aio.timeout(_PATIENCE_S):
            _, writer = await asyncio.open_connection(match["six"] or match["four"], int(match["port"]), ssl=context)
    except TimeoutError:
        return "no answer in time"
    except ssl.SSLCertVerificationError as error:
        return f"its certificate is not trusted ({error.verify_message}): is it of another fleet?"
    except ssl.SSLError as error:
        return f"no TLS is spoken there ({error.reason})"
    except socket.gaierror:
        return "its name is not known"
    except OSError as error:
        return os.strerror(error.errno) if error.errno else str(error) or type(error).__name__
    writer.transport.abort()
    return "it answers, and refuses our certificate, or is not ready yet"
