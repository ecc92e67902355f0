"""The image, built and run, and the networks of the compose file."""

from __future__ import annotations

import contextlib
import json
import os
import shlex
import signal
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
import yaml

from tests.deploy.debian import debian, need, wheelhouse
from tests.deploy.place import DEPLOY, ROOT
from tests.support.until import PATIENCE_S, until

pytestmark = [pytest.mark.slow, pytest.mark.netns, pytest.mark.timeout(3600)]

COMPOSE = yaml.safe_load((DEPLOY / "compose.yaml").read_text("utf-8"))


class Image:
    """The image in a store of its own; commands run in it without a container runtime, as its user."""

    def __init__(self, store: Path) -> None:
        self._environ = {**os.environ, "STORAGE_DRIVER": "vfs", "BUILDAH_ISOLATION": "chroot"}
        self._root = ["--root", str(store / "root"), "--runroot", str(store / "run")]
        self._container = ""

    def buildah(self, *arguments: str) -> str:
        command = ["buildah", *self._root, *arguments]
        return subprocess.run(command, env=self._environ, check=True, stdout=subprocess.PIPE, text=True).stdout.strip()

    def build(self, base: Path, wheels: Path) -> None:
        scratch = self.buildah("from", "scratch")
        self.buildah("add", "--quiet", scratch, str(base), "/")
        self.buildah("commit", "--quiet", "--rm", scratch, "localhost/base")
        arguments = ["BASE=localhost/base", "PIP_NO_INDEX=1", "PIP_FIND_LINKS=/wheels"]
        options = [f"--build-arg={argument}" for argument in arguments]
        file = ["--format=docker", f"--file={DEPLOY / 'Containerfile'}", "--tag=localhost/ropeway"]
        self.buildah("build", "--network=host", *options, f"--volume={wheels}:/wheels:ro", *file, str(ROOT))
        self._container = self.buildah("from", "localhost/ropeway")

    def configuration(self) -> dict[str, Any]:
        found: dict[str, Any] = json.loads(self.buildah("inspect", "--type=image", "localhost/ropeway"))
        return dict(found["Docker"]["config"])

    def command(self, *arguments: str, space: str = "", options: tuple[str, ...] = ()) -> list[str]:
        """Return the command line that runs something in the image, in the network namespace ``space``."""
        inside = ["ip", "netns", "exec", space] if space else []
        return [*inside, "buildah", *self._root, "run", *options, self._container, "--", *arguments]

    def start(self, *arguments: str, space: str = "", options: tuple[str, ...] = ()) -> subprocess.Popen[str]:
        command = self.command(*arguments, space=space, options=options)
        return subprocess.Popen(command, env=self._environ, stdout=subprocess.PIPE, text=True, start_new_session=True)

    def run(self, *arguments: str, options: tuple[str, ...] = ()) -> subprocess.CompletedProcess[str]:
        command = self.command(*arguments, options=options)
        return subprocess.run(command, env=self._environ, capture_output=True, text=True, check=False)

    def close(self) -> None:
        self.buildah("rm", "--all")
        self.buildah("rmi", "--all", "--force")


@pytest.fixture(scope="module")
def image(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Image]:
    """The image as its file builds it, on a small Debian."""
    need("buildah", "ip")
    found = Image(tmp_path_factory.mktemp("store"))
    found.build(debian(), wheelhouse(tmp_path_factory.mktemp("wheels")))
    yield found
    found.close()


def _end(*processes: subprocess.Popen[str]) -> None:
    for process in processes:
        with contextlib.suppress(ProcessLookupError):  # it has ended, and the test says why
            os.killpg(process.pid, signal.SIGTERM)
    for process in processes:
        process.communicate(timeout=PATIENCE_S)


def test_what_the_image_says(image: Image) -> None:
    """The image is no root's, has a health check and a volume, and runs a gateway unless told another verb."""
    found = image.configuration()
    assert found["User"] == "10001:10001"
    assert found["Entrypoint"] == ["ropeway"]
    assert found["Cmd"] == ["run", "/etc/ropeway/gateway.yaml"]
    assert found["Volumes"] == {"/var/lib/ropeway": {}}
    assert "/tmp/ropeway-alive" in found["Healthcheck"]["Test"][-1]


def test_what_is_in_it(image: Image) -> None:
    """The command is on the path, its user may write its state and nothing of the program, and no sources are left."""
    assert image.run("ropeway", "--version").stdout.startswith("ropeway ")
    assert image.run("sh", "-c", "touch /var/lib/ropeway/x && rm /var/lib/ropeway/x").returncode == 0
    assert image.run("touch", "/opt/ropeway/x").returncode != 0
    assert image.run("test", "-e", "/src").returncode != 0


async def test_a_gateway_in_it(image: Image, tmp_path: Path) -> None:
    """A gateway reads a secret that only the image's user can read, and is healthy once it runs."""
    (tmp_path / "token").write_text("a-secret-of-this-test")
    (tmp_path / "token").chmod(0o400)
    os.chown(tmp_path / "token", 10001, 10001)
    token = {"token": {"file": "/run/secrets/token"}}
    gateway = {"name": "here", "graphs": ["memory:here"], "listen": ["ws://127.0.0.1:0"], "auth": {"tokens": [token]}}
    (tmp_path / "gateway.yaml").write_text(json.dumps({"gateway": gateway}))
    (tmp_path / "tmp").mkdir()
    (tmp_path / "tmp").chmod(0o1777)
    mounts = (
        f"--volume={tmp_path}/gateway.yaml:/etc/ropeway/gateway.yaml:ro",
        f"--volume={tmp_path}/token:/run/secrets/token:ro",
        f"--volume={tmp_path}/tmp:/tmp",
    )
    check = shlex.split(image.configuration()["Healthcheck"]["Test"][-1])
    assert check[0] == "test"
    healthy = ("sh", "-c", image.configuration()["Healthcheck"]["Test"][-1])
    assert image.run(*healthy, options=mounts).returncode != 0
    process = image.start("ropeway", "run", "/etc/ropeway/gateway.yaml", options=mounts)
    try:
        await until(lambda: (tmp_path / "tmp/ropeway-alive").exists() or process.poll() is not None)
        assert image.run(*healthy, options=mounts).returncode == 0
    finally:
        _end(process)


@pytest.fixture
def spaces() -> Iterator[dict[str, str]]:
    """A network namespace for each service of the compose file, on bridges that are its networks."""
    need("ip")
    hub = f"rw{os.getpid()}hub"
    found = {service: f"rw{os.getpid()}{index}" for index, service in enumerate(COMPOSE["services"])}

    def ip(*arguments: str) -> None:
        subprocess.run(["ip", *arguments], check=True)

    try:
        for space in (hub, *found.values()):
            ip("netns", "add", space)
            ip("-n", space, "link", "set", "lo", "up")
        for network in COMPOSE["networks"]:
            ip("-n", hub, "link", "add", network, "type", "bridge", "mcast_snooping", "0")
            ip("-n", hub, "link", "set", network, "up")
        for index, (service, space) in enumerate(found.items()):
            for network, given in COMPOSE["services"][service]["networks"].items():
                end = f"{network}{index}"
                ip("-n", hub, "link", "add", end, "type", "veth", "peer", network, "netns", space)
                ip("-n", hub, "link", "set", end, "master", network, "up")
                ip("-n", space, "addr", "add", f"{given['ipv4_address']}/24", "dev", network)
                ip("-n", space, "link", "set", network, "up")
        yield found
    finally:
        for space in (hub, *found.values()):
            subprocess.run(["ip", "netns", "del", space], check=False)


def test_two_networks_that_meet_in_gateways(image: Image, spaces: dict[str, str]) -> None:
    """What is said on the robot's network is heard on the cloud's, though no node of one reaches the other."""
    started: list[subprocess.Popen[str]] = []
    try:
        for service, space in spaces.items():
            given = COMPOSE["services"][service]
            mounts = [mount.replace("./", f"{DEPLOY}/", 1) for mount in given.get("volumes", ())]
            options = ("--env=ROPEWAY_TOKEN=known-to-both-of-them", *(f"--volume={mount}" for mount in mounts))
            words = given.get("command", ["run", "/etc/ropeway/gateway.yaml"])
            started.append(image.start("ropeway", *words, space=space, options=options))
        listener = started[list(spaces).index("listener")]
        assert listener.stdout is not None
        assert listener.stdout.readline() == "data: hello from the robot\n"
        addresses = [n["ipv4_address"] for n in COMPOSE["services"]["listener"]["networks"].values()]
        routes = subprocess.run(
            ["ip", "-n", spaces["talker"], "route", "get", addresses[0]], capture_output=True, check=False
        )
        assert routes.returncode != 0
    finally:
        _end(*started)
