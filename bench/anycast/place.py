"""A robot and its machines as processes, each machine at the end of a link of its own."""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any, Final

from bench.netns import Process

__all__ = ["Place", "place"]

PORT: Final = 9090
_places = itertools.count()


class Machine:
    """A machine in a namespace of its own, and the link to it."""

    def __init__(self, name: str, robot: str, number: int, delay_ms: float, calls: str, directory: Path) -> None:
        self.name, self.calls, self._namespace = name, calls, f"{robot}m{number}"
        self.ip = f"10.9.{number}.2"
        self.address = f"ws://{self.ip}:{PORT}"
        self._control = directory / f"{number}.ctl"
        words = ["--a", robot, f"10.9.{number}.1", "--b", self._namespace, self.ip]
        words += ["--delay-ms", str(delay_ms), "--control", str(self._control)]
        self._link = subprocess.Popen([sys.executable, os.environ["ROPEWAY_LINK"], *words], stdout=subprocess.PIPE)
        assert self._link.stdout is not None
        self._link.stdout.readline()
        self.process: Process | None = None
        try:
            self.start()
        except BaseException:
            self.end()
            raise

    def start(self) -> None:
        """Start its process, and wait until it listens."""
        name = self.name.replace(" ", "_")
        self.process = Process(self._namespace, "-m", "bench.anycast.machine", name, str(PORT), self.calls)
        if not self.process.line():
            raise SystemExit(f"{self.name} did not start")

    def kill(self) -> None:
        """Kill its process, as a provider takes a spot machine away."""
        assert self.process is not None
        os.kill(self.process.pid, signal.SIGKILL)
        self.process.stop()

    def signal(self, number: int) -> None:
        """Stop its process, or let it go on."""
        assert self.process is not None
        os.kill(self.process.pid, number)

    def link(self, words: str) -> float:
        """Change the link; return when that was."""
        with self._control.open("w") as control:
            control.write(words + "\n")
        return time.monotonic()

    def end(self) -> None:
        """End the process, the link and the namespace."""
        if self.process is not None:
            with contextlib.suppress(ProcessLookupError):
                self.signal(signal.SIGCONT)
            self.process.stop()
        self._link.terminate()
        self._link.wait()
        subprocess.run(["ip", "netns", "del", self._namespace], check=False, capture_output=True)


class Place:
    """A robot in a namespace, and machines by name."""

    def __init__(self, robot: str, machines: Mapping[str, Machine]) -> None:
        self.machines = dict(machines)
        self._robot = Process(robot, "-m", "bench.anycast.robot", quiet=False)

    def begin(self, do: str, names: list[str], **asked: Any) -> None:
        """Have the robot begin something with some of the machines; it has reached them then."""
        addresses = [self.machines[name].address for name in names]
        self._robot.tell(json.dumps({"do": do, "addresses": addresses, **asked}))
        if self._robot.line().strip() != "begun":
            raise SystemExit("the robot did not begin")

    def result(self) -> dict[str, Any]:
        """Return what came of it."""
        found: dict[str, Any] = json.loads(self._robot.line())
        return found

    def name_of(self, address: str) -> str:
        """Return the machine at an address."""
        return next((m.name for m in self.machines.values() if m.address == address), address)

    def end(self) -> None:
        """End everything."""
        self._robot.stop()
        for machine in self.machines.values():
            machine.end()


@contextlib.contextmanager
def place(delays_ms: Mapping[str, float], *, calls: str = "fixed:0.004") -> Iterator[Place]:
    """Start machines behind links with these delays (one way), and a robot; all of it ends with the block."""
    robot = f"rwany{os.getpid()}r{next(_places)}"
    machines: dict[str, Machine] = {}
    with tempfile.TemporaryDirectory() as directory:
        made: Place | None = None
        try:
            for number, (name, delay_ms) in enumerate(delays_ms.items(), 1):
                machines[name] = Machine(name, robot, number, delay_ms, calls, Path(directory))
            made = Place(robot, machines)
            yield made
        finally:
            if made is not None:
                made.end()
            else:
                for machine in machines.values():
                    machine.end()
            subprocess.run(["ip", "netns", "del", robot], check=False, capture_output=True)
