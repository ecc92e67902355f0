"""Two networks on one machine: namespaces joined by a veth pair with a rate, or with nothing between."""

from __future__ import annotations

import contextlib
import os
import shlex
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

from bench.shares import Share, asked

__all__ = ["ROS_ENVIRONMENT", "Network", "Process", "delayed", "network", "ros_bridge"]

ROS_ENVIRONMENT: Final = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "RMW_IMPLEMENTATION": "rmw_cyclonedds_cpp"}


def _run(command: str) -> None:
    subprocess.run(command.split(), check=True, capture_output=True)


class Process:
    """A program, of Python unless another is named, in a namespace; its standard output is captured as text."""

    def __init__(
        self, namespace: str | None, *args: str, quiet: bool = True, program: str = sys.executable, **environment: str
    ) -> None:
        prefix = ["ip", "netns", "exec", namespace] if namespace else []
        compiled = {k: v for k, v in os.environ.items() if k != "PYTHONDONTWRITEBYTECODE"}  # as what pip installs is
        self._popen = subprocess.Popen(
            [*prefix, program, *args],
            env={**compiled, **environment},
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL if quiet else None,
            stdin=subprocess.PIPE,
            text=True,
        )
        self.pid = self._popen.pid
        processors = asked() if args[:3] == ("-m", "ropeway", "run") else None
        self._share = Share(self.pid, processors) if processors is not None else None

    def line(self) -> str:
        """The next line it prints."""
        assert self._popen.stdout is not None
        return self._popen.stdout.readline()

    def tell(self, line: str = "") -> None:
        """Write it a line."""
        assert self._popen.stdin is not None
        self._popen.stdin.write(line + "\n")
        self._popen.stdin.flush()

    def finish(self, timeout_s: float = 30) -> str:
        """Wait for its end; gives the rest of its output."""
        return self._popen.communicate(timeout=timeout_s)[0]

    @property
    def running(self) -> bool:
        """True until it ends."""
        return self._popen.poll() is None

    def stop(self) -> None:
        """End it."""
        if self._popen.poll() is None:
            self._popen.terminate()
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._popen.wait(5)
            if self._popen.poll() is None:
                self._popen.kill()
        self._popen.communicate()
        if self._share is not None:
            self._share.remove()

    def cpu_s(self) -> float:
        """Processor seconds used so far."""
        import psutil

        times = psutil.Process(self.pid).cpu_times()
        return times.user + times.system

    def memory_bytes(self) -> int:
        """Resident memory now."""
        import psutil

        return psutil.Process(self.pid).memory_info().rss


def ros_bridge(command: str, domain: int, port: int) -> Process:
    """Start another bridge of ROS 2; its command may name ``{domain}`` and ``{port}``."""
    program, *words = shlex.split(command.format(domain=domain, port=port))
    return Process(None, *words, quiet=True, program=program, **ROS_ENVIRONMENT)


@dataclass
class Network:
    """Namespaces ``a`` and ``b`` and their addresses on the link between them."""

    a: str
    b: str
    address_a: str
    address_b: str
    processes: list[Process] = field(default_factory=list)

    def start(
        self, where: str, *args: str, quiet: bool = True, program: str = sys.executable, **environment: str
    ) -> Process:
        """Run a program, of Python unless another is named, in namespace ``a`` or ``b``."""
        process = Process({"a": self.a, "b": self.b}[where], *args, quiet=quiet, program=program, **environment)
        self.processes.append(process)
        return process

    def rate(self, mbit: float) -> None:
        """Limit both directions; 0 takes the limit away."""
        for namespace in (self.a, self.b):
            with contextlib.suppress(subprocess.CalledProcessError):
                _run(f"tc -n {namespace} qdisc del dev wire root")
            if mbit:
                _run(f"tc -n {namespace} qdisc add dev wire root tbf rate {mbit}mbit burst 64kb latency 50ms")

    def cut(self, down: bool = True) -> None:
        """Cut or restore the link."""
        _run(f"ip -n {self.a} link set wire {'down' if down else 'up'}")


@contextlib.contextmanager
def network(mbit: float = 0, *, name: str = "rw", subnet: int = 77) -> Iterator[Network]:
    """Make the two namespaces; everything in them is ended and removed at the end."""
    a, b = f"{name}a", f"{name}b"
    for namespace in (a, b):
        with contextlib.suppress(subprocess.CalledProcessError):
            _run(f"ip netns del {namespace}")
        _run(f"ip netns add {namespace}")
        _run(f"ip -n {namespace} link set lo up")
    _run(f"ip link add wire netns {a} type veth peer name wire netns {b}")
    for namespace, last in ((a, 1), (b, 2)):
        _run(f"ip -n {namespace} addr add 10.{subnet}.0.{last}/24 dev wire")
        _run(f"ip -n {namespace} link set wire up")
    made = Network(a, b, f"10.{subnet}.0.1", f"10.{subnet}.0.2")
    made.rate(mbit)
    try:
        yield made
    finally:
        for process in reversed(made.processes):
            process.stop()
        for namespace in (a, b):
            with contextlib.suppress(subprocess.CalledProcessError):
                _run(f"ip netns del {namespace}")


@contextlib.contextmanager
def delayed(
    name: str, subnet: str, *, delay_ms: float, jitter_ms: float = 0.0, loss: float = 0.0, rate_mbit: float = 0.0
) -> Iterator[tuple[str, str, str] | None]:
    """Two namespaces joined by a link with delay, and the address of the second; ``None`` without a program for it.

    The program is named in ROPEWAY_LINK: ``PROGRAM --a NAMESPACE ADDRESS --b NAMESPACE ADDRESS --delay-ms N
    --jitter-ms N --loss SHARE --rate-mbit N``; it prints a line once packets flow.
    """
    program = os.environ.get("ROPEWAY_LINK")
    if not program:
        print("skipped; name a program that joins namespaces in ROPEWAY_LINK")
        yield None
        return
    a, b, near_ip, far_ip = f"{name}a", f"{name}b", f"{subnet}.1", f"{subnet}.2"
    words = ["--a", a, near_ip, "--b", b, far_ip, "--delay-ms", str(delay_ms), "--jitter-ms", str(jitter_ms)]
    words += ["--loss", str(loss), "--rate-mbit", str(rate_mbit)]
    process = subprocess.Popen([sys.executable, program, *words], stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.readline()
    try:
        yield a, b, far_ip
    finally:
        process.terminate()
        process.wait()
        for namespace in (a, b):
            subprocess.run(["ip", "netns", "del", namespace], check=False, capture_output=True)
