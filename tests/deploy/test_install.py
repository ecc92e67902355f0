"""The lines of README's section Install, run where nothing is installed but Python."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable, Iterator

import pytest

from tests.deploy.debian import debian, wheelhouse
from tests.deploy.place import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.timeout(3600)]

Shell = Callable[[str], str]
INSTALL = (ROOT / "README.md").read_text("utf-8").partition("\n## Install\n")[2].partition("\n## ")[0]
LINES = [line.partition("  #")[0].strip() for line in re.findall(r"^\$ (.*)$", INSTALL, re.MULTILINE)]


@pytest.fixture(scope="module")
def shell(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Shell]:
    """A shell in a fresh Debian whose pip knows wheels in a directory, and nothing else."""
    root = tmp_path_factory.mktemp("fresh")
    subprocess.run(["cp", "-a", f"{debian()}/.", str(root)], check=True)
    wheelhouse(root / "wheels")
    names = subprocess.run(["git", "ls-files", "-z"], cwd=ROOT, capture_output=True, check=True).stdout
    for name in names.decode().split("\0"):
        if name.startswith(("src/", "pyproject.toml", "README.md", "LICENSE")):
            (root / "root/checkout" / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(ROOT / name, root / "root/checkout" / name)
    mounted = 'mount -t proc proc "$0/proc" && mount --rbind /dev "$0/dev" && exec chroot "$0" sh -euc "$1"'
    path = "/usr/sbin:/usr/bin:/sbin:/bin"
    environ = {"PATH": path, "HOME": "/root", "PIP_NO_INDEX": "1", "PIP_FIND_LINKS": "/wheels"}

    def run(text: str) -> str:
        inside = ["unshare", "--mount", "--pid", "--fork", "--kill-child", "sh", "-c", mounted, str(root), text]
        done = subprocess.run(inside, env=environ, stdout=subprocess.PIPE, text=True, check=True)
        return done.stdout

    yield run
    shutil.rmtree(root)


def test_lines_are_known() -> None:
    """The section shows what is tried here, and pipx and uv, which no small Debian has."""
    assert LINES == [
        "pipx install ropeway",
        "python3 -m venv ~/ropeway && ~/ropeway/bin/pip install ropeway",
        "pip install .",
    ]


def test_an_environment_of_its_own(shell: Shell) -> None:
    """The command works after the line that makes an environment for it, and an extra can be added."""
    shell(LINES[1])
    assert shell("~/ropeway/bin/ropeway --version").startswith("ropeway ")
    shell("~/ropeway/bin/pip install 'ropeway[overlay]' && ~/ropeway/bin/ropeway keys init fleet")


def test_beside_the_packages_of_the_system(shell: Shell) -> None:
    """An environment that sees the system's packages, as one beside ROS 2 does, is as good."""
    shell("python3 -m venv --system-site-packages ~/beside && ~/beside/bin/pip install ropeway")
    assert shell("~/beside/bin/ropeway topic list -g memory:here --spin-time 0") == ""


def test_a_checkout(shell: Shell) -> None:
    """The line that installs a checkout works in any environment."""
    shell(
        f"cd ~/checkout && python3 -m venv ~/other && . ~/other/bin/activate && {LINES[2]} && cd / && ropeway --version"
    )


def test_one_file_for_robots(shell: Shell) -> None:
    """The file for robots with an old Python runs where nothing of Ropeway is installed."""
    assert "usage" in shell("cp ~/checkout/src/ropeway/iort.py /tmp/iort.py && python3 /tmp/iort.py --help")
