"""The package for Debian, installed and started in a small Debian."""

from __future__ import annotations

import shutil
import signal
import socket
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.deploy.debian import debian
from tests.deploy.place import DEPLOY, ROOT
from tests.support.until import PATIENCE_S

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]


@pytest.fixture(scope="module")
def system(packages: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """A Debian in which the package is installed."""
    root = tmp_path_factory.mktemp("system")
    subprocess.run(["cp", "-a", f"{debian()}/.", str(root)], check=True)
    shutil.copy(packages["amd64"], root / "tmp/ropeway.deb")
    for device in ("null", "urandom"):
        (root / "dev" / device).touch()
        subprocess.run(["mount", "--bind", f"/dev/{device}", str(root / "dev" / device)], check=True)
    try:
        subprocess.run(["chroot", str(root), "dpkg", "--install", "/tmp/ropeway.deb"], check=True)
        yield root
    finally:
        for device in ("null", "urandom"):
            subprocess.run(["umount", str(root / "dev" / device)], check=False)


@pytest.mark.parametrize(("architecture", "machine"), [("amd64", b"\x3e\x00"), ("arm64", b"\xb7\x00")])
def test_compiled_modules(packages: dict[str, Path], tmp_path: Path, architecture: str, machine: bytes) -> None:
    """Each package says its architecture, and all compiled modules in it are for that one."""
    field = ["dpkg-deb", "--field", str(packages[architecture]), "Architecture"]
    assert subprocess.run(field, capture_output=True, text=True, check=True).stdout.strip() == architecture
    subprocess.run(["dpkg-deb", "--extract", str(packages[architecture]), str(tmp_path)], check=True)
    modules = [file for file in tmp_path.rglob("*.so*") if file.is_file() and file.read_bytes()[:4] == b"\x7fELF"]
    assert modules
    assert {file.read_bytes()[18:20] for file in modules} == {machine}


def test_what_is_installed(system: Path) -> None:
    """The command runs, the units and an example are there, and secrets have a directory closed to others."""
    run = subprocess.run(["chroot", str(system), "ropeway", "--version"], capture_output=True, text=True, check=True)
    assert run.stdout.startswith("ropeway ")
    for unit in (DEPLOY / "systemd").glob("*.service"):
        assert (system / "lib/systemd/system" / unit.name).read_text() == unit.read_text()
    example = "/usr/share/doc/ropeway/examples/robot.yaml"
    subprocess.run(
        ["chroot", str(system), "ropeway", "config", "check", example],
        env={"ROPEWAY_TOKEN": "x", "PATH": "/usr/sbin:/usr/bin:/sbin:/bin"},
        check=True,
    )
    assert (system / "etc/ropeway").stat().st_mode & 0o777 == 0o750


def test_the_service_starts(system: Path) -> None:
    """What the unit starts, as its user, tells the service manager that it is ready and that it stops."""
    (system / "etc/ropeway/gateway.yaml").write_text('gateway: {name: here, graphs: ["memory:here"], listen: []}\n')
    (command,) = [
        line.removeprefix("ExecStart=").split()
        for line in (system / "lib/systemd/system/ropeway-gateway.service").read_text().splitlines()
        if line.startswith("ExecStart=")
    ]
    manager = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    manager.settimeout(PATIENCE_S)
    manager.bind(str(system / "tmp/notify"))
    (system / "tmp/notify").chmod(0o777)
    process = subprocess.Popen(
        ["chroot", "--userspec=ropeway:ropeway", str(system), *command],
        env={"NOTIFY_SOCKET": "/tmp/notify", "HOME": "/var/lib/ropeway", "PATH": "/usr/sbin:/usr/bin:/sbin:/bin"},
    )
    try:
        assert manager.recv(4096).startswith(b"READY=1")
        process.send_signal(signal.SIGTERM)
        assert manager.recv(4096) == b"STOPPING=1"
        assert process.wait(PATIENCE_S) == 0
    finally:
        process.kill()
        process.wait()
        manager.close()


def test_it_can_be_removed(system: Path) -> None:
    """Nothing of the program is left after it was removed."""
    subprocess.run(["chroot", str(system), "dpkg", "--purge", "ropeway"], check=True)
    assert not (system / "usr/lib/ropeway").exists()
    assert not (system / "usr/bin/ropeway").exists()


def test_another_python(tmp_path: Path) -> None:
    """A package for an older Python than the one that builds it has what fits that Python."""
    build = [sys.executable, "deploy/debian/build.py", "amd64", "--python", "3.10", "--out", str(tmp_path)]
    subprocess.run(build, cwd=ROOT, check=True)
    (package,) = tmp_path.glob("*.deb")
    field = ["dpkg-deb", "--field", str(package), "Depends"]
    assert "python3 (<< 3.11)" in subprocess.run(field, capture_output=True, text=True, check=True).stdout
    subprocess.run(["dpkg-deb", "--extract", str(package), str(tmp_path / "tree")], check=True)
    modules = [file.name for file in (tmp_path / "tree").rglob("*.cpython-*.so")]
    assert modules
    assert [name for name in modules if "-310-" not in name and "-310d-" not in name] == []
