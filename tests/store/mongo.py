"""A real server of MongoDB's wire protocol: ``MONGODB_URL``, or ``mongod`` or ``ferretdb`` of the PATH."""

from __future__ import annotations

import contextlib
import os
import shutil
import socket
import subprocess
import sys
import time
import uuid
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.support.ports import free_port

__all__ = ["MongoServer", "mongo_database"]


class MongoServer:
    """A server that can be stopped and started again with what it kept."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.port = free_port()
        self.url = f"mongodb://127.0.0.1:{self.port}/ropeway"
        self._process: subprocess.Popen[bytes] | None = None

    @staticmethod
    def program() -> str | None:
        built = Path(sys.executable).with_name("ferretdb")  # of tests/store/ferretdb, by .ci/run
        return shutil.which("mongod") or (str(built) if built.exists() else shutil.which("ferretdb"))

    def start(self) -> None:
        program = self.program()
        assert program is not None
        self.directory.mkdir(exist_ok=True)
        if program.endswith("mongod"):
            command = [program, "--dbpath", str(self.directory), "--port", str(self.port), "--bind_ip", "127.0.0.1"]
        elif Path(program).parent == Path(sys.executable).parent:
            command = [program, f"127.0.0.1:{self.port}", str(self.directory)]
        else:
            command = [
                program,
                "--handler=sqlite",
                f"--sqlite-url=file:{self.directory}/",
                f"--listen-addr=127.0.0.1:{self.port}",
                "--debug-addr=-",
                "--telemetry=disable",
                f"--state-dir={self.directory}",
            ]
        self._process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 20
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
                return
            assert time.monotonic() < deadline, "the database does not listen"
            assert self._process.poll() is None, "the database ended"
            time.sleep(0.05)

    def stop(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.wait()
            self._process = None


@contextlib.contextmanager
def mongo_database(directory: Path) -> Iterator[str]:
    """The URL of an empty database; the test is skipped where no server can be had."""
    given = os.environ.get("MONGODB_URL")
    if given:
        yield f"{given.rstrip('/')}/ropeway_{uuid.uuid4().hex[:12]}"
        return
    if MongoServer.program() is None:
        pytest.skip("needs MONGODB_URL, mongod, or the ferretdb that .ci/run builds with Go")
    server = MongoServer(directory / "mongo")
    server.start()
    try:
        yield server.url
    finally:
        server.stop()
