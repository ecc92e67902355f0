"""Looks at the machine: network interfaces, buffers, ports, the clock, open files."""

from __future__ import annotations

import contextlib
import ctypes
import os
import socket
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Final

from ropeway.cli.doctor.symptom import Symptom

__all__ = ["machine"]

_UP, _LOOPBACK, _MULTICAST = 0x1, 0x8, 0x1000  # of <linux/if.h>
_BUFFER_BYTES: Final = 2 << 20  # an image that comes in one burst
_OPEN_FILES: Final = 1024
_PORT: Final = 9090
_CLOCK_ERROR: Final = 5  # TIME_ERROR of adjtimex
_TIMEX_BYTES: Final = 208


def machine(root: Path = Path("/")) -> Iterator[Symptom]:
    """Yield what there is to say of the machine; ``root`` is where /proc and /sys are."""
    yield from _interfaces(root)
    yield from _buffers(root)
    yield from _congestion(root)
    yield from _port()
    yield from _clock()
    yield from _files()


def _interfaces(root: Path) -> Iterator[Symptom]:
    folder = root / "sys/class/net"
    if not folder.is_dir():
        return
    usable: list[str] = []
    mute: list[str] = []
    for entry in sorted(folder.iterdir()):
        with contextlib.suppress(OSError, ValueError):
            flags = int((entry / "flags").read_text(), 16)
            if flags & _UP and not flags & _LOOPBACK:
                (usable if flags & _MULTICAST else mute).append(entry.name)
    if usable:
        yield Symptom(True, "interfaces", f"up, with multicast: {', '.join(usable)}")
    else:
        yield Symptom(
            None,
            "interfaces",
            "no interface with multicast is up: DDS finds nodes of this machine only",
            "name other machines in ROS_STATIC_PEERS; links over ws:// need no multicast",
        )
    for name in mute:
        yield Symptom(
            None,
            "interfaces",
            f"{name} has no multicast, so DDS discovers nothing over it",
            f"ip link set {name} multicast on, or name peers in ROS_STATIC_PEERS",
        )


def _buffers(root: Path) -> Iterator[Symptom]:
    for name, what in (("rmem_max", "received"), ("wmem_max", "sent")):
        with contextlib.suppress(OSError, ValueError):
            size = int((root / "proc/sys/net/core" / name).read_text())
            if size >= _BUFFER_BYTES:
                yield Symptom(True, "buffers", f"net.core.{name} is {size}")
            else:
                text = f"net.core.{name} is {size}: images over DDS may lose packets before they are {what}"
                yield Symptom(None, "buffers", text, f"sysctl -w net.core.{name}={_BUFFER_BYTES}")


def _congestion(root: Path) -> Iterator[Symptom]:
    with contextlib.suppress(OSError):
        known = (root / "proc/sys/net/ipv4/tcp_available_congestion_control").read_text().split()
        if "bbr" in known:
            yield Symptom(True, "congestion", "links use bbr, which takes no lost packet for a full link")
        else:
            text = f"the kernel has no bbr ({', '.join(known)}): links that lose packets are slower"
            yield Symptom(None, "congestion", text, "modprobe tcp_bbr")


def _port() -> Iterator[Symptom]:
    with socket.socket() as probe:
        probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(("127.0.0.1", _PORT))
        except OSError:
            yield Symptom(
                None,
                "port",
                f"port {_PORT} is taken, perhaps by a rosbridge or another gateway",
                'give "listen" another port, or [] where the gateway only dials out',
            )
        else:
            yield Symptom(True, "port", f"port {_PORT} is free")


def _clock() -> Iterator[Symptom]:
    if not sys.platform.startswith("linux"):
        return
    state = ctypes.CDLL(None).adjtimex(ctypes.create_string_buffer(_TIMEX_BYTES))  # reads only: no mode is set
    if state == _CLOCK_ERROR:
        text = (
            "the clock is not synchronised: delays between machines cannot be told, overlay certificates may not hold"
        )
        yield Symptom(None, "clock", text, "systemctl enable --now systemd-timesyncd, or chrony")
    elif state >= 0:
        yield Symptom(True, "clock", "the clock is synchronised")


def _files() -> Iterator[Symptom]:
    try:
        import resource
    except ImportError:  # Windows knows no such limit
        return
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    most = max(soft, hard) if hard != resource.RLIM_INFINITY else hard
    if most != resource.RLIM_INFINITY and most < _OPEN_FILES:
        text = f"{most} files may be open, each connection is one"
        yield Symptom(None, "files", text, "ulimit -n 4096, or LimitNOFILE= in the unit")
    else:
        count = "any number of" if most == resource.RLIM_INFINITY else str(most)
        yield Symptom(True, "files", f"{count} files may be open; {os.cpu_count()} processors")
