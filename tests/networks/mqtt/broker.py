"""A real broker, Debian's mosquitto, as a process on the loopback interface."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType

from tests.support.ports import free_port
from tests.support.until import PATIENCE_S

__all__ = ["HAS_BROKER", "MOSQUITTO", "WHY_NOT", "Broker"]

MOSQUITTO = shutil.which("mosquitto", path="/usr/sbin:/usr/local/sbin:/usr/bin") or ""
HAS_BROKER = bool(MOSQUITTO)
WHOLE_MESSAGES = "max_packet_size 268435455"  # the most that MQTT knows; mosquitto 2.1 takes 2 MB unless it is told
WHY_NOT = "needs a broker: apt install mosquitto"


class Broker:
    """A broker with a port of its own; ``settings`` are further lines of its configuration."""

    def __init__(self, *settings: str, anonymous: bool = True) -> None:
        self.port = free_port()
        self._settings = [f"allow_anonymous {str(anonymous).lower()}", *settings]
        self._directory = TemporaryDirectory()
        self._process: subprocess.Popen[bytes] | None = None

    @property
    def url(self) -> str:
        """The address of its graph."""
        return f"mqtt://127.0.0.1:{self.port}"

    def start(self) -> None:
        """Start it, and wait until it listens."""
        path = Path(self._directory.name) / "mosquitto.conf"
        own = [f"listener {self.port} 127.0.0.1", "user root", "log_dest stderr", "log_type error", WHOLE_MESSAGES]
        lines = [*own, *self._settings]
        path.write_text("\n".join([*lines, ""]))
        self._process = subprocess.Popen([MOSQUITTO, "-c", str(path)], stderr=subprocess.PIPE)
        deadline = time.monotonic() + PATIENCE_S
        while True:
            try:
                socket.create_connection(("127.0.0.1", self.port), timeout=PATIENCE_S).close()
                return
            except OSError:
                if self._process.poll() is not None or time.monotonic() > deadline:
                    said = self._process.communicate()[1].decode() if self._process.poll() is not None else ""
                    raise RuntimeError(f"mosquitto does not start: {said}") from None
                time.sleep(0.02)

    def stop(self) -> None:
        """Kill it; what it kept is forgotten."""
        process, self._process = self._process, None
        if process is not None:
            process.send_signal(signal.SIGCONT)
            process.kill()
            process.communicate()

    def pause(self) -> None:
        """Make it stall."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def go_on(self) -> None:
        """End its pause."""
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)

    def __enter__(self) -> Broker:
        self.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        self._directory.cleanup()
