"""Serves the dashboard: one process, one listener, and the gateways that it watches."""

from __future__ import annotations

import logging
import socket
import ssl
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Final
from urllib.parse import urlencode

import uvicorn

from ropeway.control.client import ControlTarget
from ropeway.dashboard.guard import LOGIN_PATH
from ropeway.dashboard.site import make_site
from ropeway.dashboard.viewers import Viewers
from ropeway.dashboard.watch_list import WatchList
from ropeway.errors import ConfigError, ConnectFailed
from ropeway.limits import CONTROL_HEAD_BYTES, DASHBOARD_CONNECTIONS
from ropeway.listener.hosts import Hosts, own_names

__all__ = ["DashboardSettings", "serve"]

log = logging.getLogger("ropeway.dashboard")

_END_S: Final = 2
_BACKLOG: Final = 64


@dataclass(frozen=True)
class DashboardSettings:
    """The settings of a dashboard: where it listens, and whom it lets in.

    ``targets`` ``None`` is for all gateways that run on this machine.
    """

    targets: Sequence[ControlTarget] | None = None
    host: str = "127.0.0.1"
    port: int = 8788
    key: str = ""
    insecure: bool = False
    names: Sequence[str] = ()
    certificate: str = ""
    certificate_key: str = ""


async def serve(settings: DashboardSettings, ready: Callable[[str], None]) -> None:
    """Serve until SIGINT or SIGTERM. ``ready`` is called with the address to open, which has the key in it."""
    viewers = Viewers(settings.key, open=settings.insecure)
    secure = bool(settings.certificate)
    if secure:
        _check_certificate(settings)
    bound = _bind(settings.host, settings.port)
    fleet = WatchList(settings.targets)
    try:
        hosts = Hosts(own_names(), tuple(name.lower() for name in settings.names))
        config = uvicorn.Config(
            make_site(fleet, viewers, hosts, secure=secure),
            log_config=None,
            access_log=False,
            proxy_headers=False,
            server_header=False,
            ws_max_size=CONTROL_HEAD_BYTES * 1024,  # a configuration from the editor
            h11_max_incomplete_event_size=CONTROL_HEAD_BYTES,
            limit_concurrency=DASHBOARD_CONNECTIONS,
            timeout_graceful_shutdown=_END_S,
            ssl_certfile=settings.certificate or None,
            ssl_keyfile=settings.certificate_key or None,
        )
        server = uvicorn.Server(config)
        ready(_address(bound, viewers, secure=secure, open=settings.insecure))
        await server.serve(sockets=[bound])
    finally:
        await fleet.close()
        bound.close()


def _check_certificate(settings: DashboardSettings) -> None:
    """Raise ``ConfigError`` where the certificate or its key is none, or they are of different pairs."""
    try:
        ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER).load_cert_chain(settings.certificate, settings.certificate_key)
    except (OSError, ssl.SSLError) as error:
        fault = f"no certificate with its key, both PEM: {error.strerror or error}"
        raise ConfigError([("--certfile, --keyfile", fault)]) from None


def _address(bound: socket.socket, viewers: Viewers, *, secure: bool, open: bool) -> str:
    host, port = bound.getsockname()[:2]
    host = "127.0.0.1" if host == "0.0.0.0" else f"[{host}]" if ":" in host else host  # noqa: S104
    root = f"{'https' if secure else 'http'}://{host}:{port}"
    return f"{root}/" if open else f"{root}{LOGIN_PATH}?{urlencode({'key': viewers.key})}"


def _bind(host: str, port: int) -> socket.socket:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
        bound = socket.socket(family, kind, protocol)
        try:
            bound.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
            bound.bind(address)
            bound.listen(_BACKLOG)
        except OSError:
            bound.close()
            raise
    except OSError as error:
        raise ConnectFailed(
            f"{host}:{port}", f"cannot listen: {error.strerror or error}; choose another --port", retryable=False
        ) from None
    return bound
