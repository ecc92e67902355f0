"""Two namespaces joined by the program that ROPEWAY_LINK names, and what is set and read of that link."""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

from bench.netns import Process

__all__ = ["FAR", "NEAR", "Link", "Shape", "program"]

NEAR, FAR = "10.79.0.1", "10.79.0.2"
_PACKET_BITS = 12_000
_UNLIMITED_MBIT = 1_000.0  # what a link without a rate may have on its way


@dataclass(frozen=True)
class Shape:
    """What a link is like, each way; a rate of 0 is unlimited, ``queue`` is how many packets may wait."""

    rate_mbit: float = 0.0
    delay_ms: float = 0.0
    jitter_ms: float = 0.0
    loss: float = 0.0
    queue: int = 1000

    @classmethod
    def parse(cls, text: str, queue: int) -> Shape:
        """Read ``rate,delay[,jitter[,loss]]``: Mbit/s, milliseconds, milliseconds, a share of packets."""
        return cls(*map(float, text.split(",")), queue=queue)  # type: ignore[misc]

    @property
    def held(self) -> int:
        """Return how many packets the link program may hold: those that wait, and those on their way."""
        on_the_way = (self.rate_mbit or _UNLIMITED_MBIT) * 1e3 * (self.delay_ms + self.jitter_ms) / _PACKET_BITS
        return self.queue + round(on_the_way)

    def __str__(self) -> str:
        rate = f"{self.rate_mbit:g} Mbit/s" if self.rate_mbit else "unlimited"
        jitter = f"±{self.jitter_ms:g}" if self.jitter_ms else ""
        loss = f", {100 * self.loss:g} % loss" if self.loss else ""
        queue = f", queue {self.queue}" if self.queue != 1000 else ""
        return f"{rate}, {self.delay_ms:g}{jitter} ms{loss}{queue}"


def program() -> str | None:
    """Return the link program, and say so where there is none.

    It is called as ``PROGRAM --a NAMESPACE ADDRESS --b NAMESPACE ADDRESS --rate-mbit N --delay-ms N --jitter-ms N
    --loss SHARE --queue PACKETS --control FIFO`` (the packets are all that it holds), prints a line once packets flow,
    and takes ``rate_mbit=N delay_ms=N loss=N`` from its FIFO while it runs.
    """
    path = os.environ.get("ROPEWAY_LINK")
    if not path:
        print("skipped: name a program that joins two namespaces in ROPEWAY_LINK")
    elif os.geteuid() != 0:
        print("skipped: namespaces need root")
        path = None
    return path


@dataclass
class Link:
    """Namespaces ``near`` and ``far``, the link between them, and the processes in them."""

    near: str
    far: str
    relay: Process
    control: Path
    processes: list[Process] = field(default_factory=list)

    @classmethod
    @contextlib.contextmanager
    def open(cls, shape: Shape, *, congestion: str | None = None) -> Iterator[Link]:
        """Make both namespaces and the link; everything in them is ended and removed at the end."""
        path = program()
        if path is None:
            raise SystemExit(0)
        near, far = (f"rww{os.getpid()}{end}" for end in "nf")
        with tempfile.TemporaryDirectory() as directory:
            control = Path(directory) / "control"
            words = ["--a", near, NEAR, "--b", far, FAR, "--control", str(control), "--queue", str(shape.held)]
            for key in ("rate_mbit", "delay_ms", "jitter_ms", "loss"):
                words += [f"--{key.replace('_', '-')}", str(getattr(shape, key))]
            link = cls(near, far, Process(None, path, *words), control)
            try:
                if not link.relay.line():
                    raise SystemExit(f"{path} ended before its link stood")
                for namespace in (near, far) if congestion else ():
                    setting = f"net.ipv4.tcp_congestion_control={congestion}"
                    _ip("netns", "exec", namespace, "sysctl", "-qw", setting)
                yield link
            finally:
                for process in (*reversed(link.processes), link.relay):
                    process.stop()
                for namespace in (near, far):
                    subprocess.run(["ip", "netns", "del", namespace], check=False, capture_output=True)

    def start(self, where: str, *args: str) -> Process:
        """Run a Python program at the ``near`` or the ``far`` end."""
        process = Process(self._namespace(where), *args, quiet=not os.environ.get("WAN_DEBUG"))
        self.processes.append(process)
        return process

    def change(self, words: str) -> None:
        """Change the link while it runs: ``rate_mbit=5 delay_ms=35``."""
        with self.control.open("w") as stream:
            stream.write(words + "\n")

    def received_bytes(self, where: str) -> int:
        """Return what came over the link to this end since it was made, headers included."""
        shown = _ip("-n", self._namespace(where), "-s", "-j", "link", "show")
        # the counters of the other end's device: what the link program read from it and dropped is not among these
        return sum(int(device["stats64"]["rx"]["bytes"]) for device in json.loads(shown) if device["ifname"] != "lo")

    def _namespace(self, where: str) -> str:
        return {"near": self.near, "far": self.far}[where]


def _ip(*words: str) -> str:
    return subprocess.run(["ip", *words], check=True, capture_output=True, text=True).stdout


def sysctl(name: str) -> str:
    """Return a setting of the kernel, or a question mark."""
    path = Path("/proc/sys", *name.split("."))
    return path.read_text().strip() if path.exists() else "?"
