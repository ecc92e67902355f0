"""The units, started, reloaded and watched by a systemd of their own."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.deploy.debian import debian
from tests.support.until import PATIENCE_S, until

pytestmark = [
    pytest.mark.slow,
    pytest.mark.timeout(3600),
    pytest.mark.skipif(shutil.which("systemd-nspawn") is None, reason="systemd-nspawn is not installed"),
]

GATEWAY = """\
gateway:
  name: here
  graphs: ["memory:here"]
  listen: ["ws://127.0.0.1:9090"]
  auth: {tokens: [{token: {file: /run/credentials/ropeway-gateway.service/token}}]}
"""
DROP_IN = """\
[Service]
LoadCredential=token:/etc/ropeway/private/token
WatchdogSec=4
"""
INSTALL = """
apt-get update -qq && apt-get install -y -qq --no-install-recommends systemd systemd-sysv dbus /root/ropeway.deb
cd /root && ropeway keys init fleet && ropeway keys issue router1 --router --fleet fleet
install -m 600 router1.ropeway /etc/ropeway/router.ropeway
systemctl enable ropeway-gateway ropeway-router
systemctl mask systemd-networkd-wait-online systemd-firstboot
"""
# A hierarchy of control groups that has nothing of this machine's, which may be of the first version.
BOOT = """
umount -R /sys/fs/cgroup; mount -t cgroup2 none /sys/fs/cgroup
mkdir -p /sys/fs/cgroup/$1 && echo $$ >/sys/fs/cgroup/$1/cgroup.procs
exec systemd-nspawn --quiet --boot --directory "$0" --machine "$1" --private-network --register=no --keep-unit \\
    --console=pipe
"""


class Machine:
    """A Debian that has booted, in a container."""

    def __init__(self, root: Path) -> None:
        environ = {**os.environ, "SYSTEMD_NSPAWN_UNIFIED_HIERARCHY": "1"}
        self._process = subprocess.Popen(
            ["unshare", "--mount", "sh", "-c", BOOT, str(root), f"ropeway{os.getpid()}"],
            env=environ,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
        )

    def run(self, *command: str) -> str:
        """Return what a command in the machine prints, and nothing while there is no machine yet."""
        pid = self._process.pid
        leaders = Path(f"/proc/{pid}/task/{pid}/children").read_text("utf-8").split()
        if not leaders:
            return ""
        inside = ["nsenter", "--target", leaders[0], "--mount", "--uts", "--ipc", "--net", "--pid", "--cgroup"]
        environ = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin"}
        done = subprocess.run([*inside, *command], env=environ, capture_output=True, text=True, check=False)
        return done.stdout.strip()

    def state(self, unit: str, key: str = "ActiveState") -> str:
        return self.run("systemctl", "show", "--value", "--property", key, unit)

    def close(self) -> None:
        self.run("systemctl", "poweroff")
        try:
            self._process.wait(PATIENCE_S)
        finally:
            self._process.kill()


@pytest.fixture(scope="module")
def machine(packages: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> Iterator[Machine]:
    """A machine on which the package is installed and both units are enabled."""
    root = tmp_path_factory.mktemp("machine")
    subprocess.run(["cp", "-a", f"{debian()}/.", str(root)], check=True)
    shutil.copy(packages["amd64"], root / "root/ropeway.deb")
    for name in ("resolv.conf", "hosts"):
        shutil.copy(f"/etc/{name}", root / "etc" / name)
    mounted = 'mount -t proc proc "$0/proc" && mount --rbind /dev "$0/dev" && exec chroot "$0" sh -euc "$1"'
    environ = {"PATH": "/usr/sbin:/usr/bin:/sbin:/bin", "DEBIAN_FRONTEND": "noninteractive", "HOME": "/root"}
    inside = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", mounted, str(root), INSTALL]
    subprocess.run(inside, env=environ, check=True)
    (root / "etc/ropeway/gateway.yaml").write_text(GATEWAY)
    (root / "etc/ropeway/gateway.yaml").chmod(0o644)
    for name, text in {
        "ropeway/private/token": "a-token-of-this-test",
        "systemd/system/ropeway-gateway.service.d/test.conf": DROP_IN,
    }.items():
        (root / "etc" / name).parent.mkdir()
        (root / "etc" / name).write_text(text)
        (root / "etc" / name).chmod(0o600)
    found = Machine(root)
    yield found
    found.close()


async def test_they_start(machine: Machine) -> None:
    """Both get ready, with secrets that only root can read, and the gateway's socket is its own."""
    for unit in ("ropeway-gateway", "ropeway-router"):
        await until(lambda unit=unit: machine.state(unit) == "active")
        assert machine.state(unit, "NRestarts") == "0"
    assert machine.run("stat", "-c", "%a %U", "/run/ropeway").split() == ["700", "ropeway"]


async def test_they_are_reloaded(machine: Machine) -> None:
    """A reload has the gateway read its certificates and tokens again, and both go on."""
    for unit in ("ropeway-gateway", "ropeway-router"):
        machine.run("systemctl", "reload", unit)
        assert (machine.state(unit), machine.state(unit, "ReloadResult")) == ("active", "success")
    await until(
        lambda: "certificates and tokens again" in machine.run("journalctl", "--unit", "ropeway-gateway", "-o", "cat")
    )


async def test_one_that_hangs(machine: Machine) -> None:
    """A gateway that hangs is killed by the watchdog, and started again."""
    machine.run("systemctl", "kill", "--kill-who=main", "--signal=STOP", "ropeway-gateway")
    await until(lambda: machine.state("ropeway-gateway", "NRestarts") == "1")
    await until(lambda: machine.state("ropeway-gateway") == "active")


async def test_one_that_is_killed(machine: Machine) -> None:
    """A router that dies is started again."""
    machine.run("systemctl", "kill", "--kill-who=main", "--signal=KILL", "ropeway-router")
    await until(lambda: machine.state("ropeway-router", "NRestarts") == "1")
    await until(lambda: machine.state("ropeway-router") == "active")


def test_they_stop(machine: Machine) -> None:
    """Both end by themselves when they are told to."""
    for unit in ("ropeway-gateway", "ropeway-router"):
        machine.run("systemctl", "stop", unit)
        assert (machine.state(unit), machine.state(unit, "Result")) == ("inactive", "success")
