"""Build Debian packages of Ropeway, with all that it needs but Python: ``python deploy/debian/build.py amd64 arm64``.

The packages are for one version of Python (``--python 3.11``, that of Debian 12), as compiled modules are. Nothing is
compiled here: wheels of each architecture are unpacked, so that one machine builds for both.
"""

from __future__ import annotations

import argparse
import compileall
import hashlib
import json
import py_compile
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

from packaging.requirements import Requirement

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
MACHINES = {"amd64": "x86_64", "arm64": "aarch64"}
GLIBCS = ("2_36", "2_35", "2_34", "2_31", "2_28", "2_27", "2_24", "2_17", "2014")  # Debian 12 has 2.36
EXTRAS = ("bags", "mongo", "mqtt", "overlay", "zenoh")  # a service is to lack nothing; it draws nothing
HOME = "usr/lib/ropeway"
PYTHON_OF_DEBIAN = "3.11.2"


def main() -> None:
    """Build a package for each architecture that was named."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("architectures", nargs="+", choices=sorted(MACHINES))
    parser.add_argument("--python", default="3.11", help="the version of Python that the system has (3.11)")
    parser.add_argument("--out", type=Path, default=ROOT / "dist", help="where the packages go (dist/)")
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as scratch:
        wheel = _wheel(Path(scratch))
        for architecture in given.architectures:
            print(_package(wheel, architecture, given.python, Path(scratch) / architecture, given.out))


def _pip(*arguments: str) -> None:
    subprocess.run([sys.executable, "-m", "pip", "--disable-pip-version-check", "--quiet", *arguments], check=True)


def _wheel(scratch: Path) -> Path:
    _pip("wheel", "--no-deps", "--wheel-dir", str(scratch), str(ROOT))
    (found,) = scratch.glob("ropeway-*.whl")
    return found


def _package(wheel: Path, architecture: str, python: str, tree: Path, out: Path) -> Path:
    version = wheel.name.split("-")[1]
    site = tree / HOME / f"lib/python{python}/site-packages"
    _install(wheel, architecture, python, site)
    shutil.rmtree(site / "bin", ignore_errors=True)
    if python == f"{sys.version_info[0]}.{sys.version_info[1]}":
        mode = py_compile.PycInvalidationMode.UNCHECKED_HASH
        compileall.compile_dir(site, quiet=2, stripdir=str(tree), invalidation_mode=mode)
    (tree / HOME / "pyvenv.cfg").write_text("home = /usr/bin\ninclude-system-site-packages = false\n")
    (tree / HOME / "bin").mkdir()
    (tree / HOME / "bin/python3").symlink_to("/usr/bin/python3")
    _write(tree / "usr/bin/ropeway", (HERE / "ropeway").read_text(), executable=True)
    for unit in (ROOT / "deploy/systemd").glob("*.service"):
        _write(tree / "lib/systemd/system" / unit.name, unit.read_text())
    shutil.copytree(ROOT / "deploy/compose", tree / "usr/share/doc/ropeway/examples")
    _write(tree / "usr/share/doc/ropeway/copyright", (HERE / "copyright").read_text())
    for script in ("postinst", "prerm", "postrm"):
        _write(tree / "DEBIAN" / script, (HERE / script).read_text(), executable=True)
    major, minor = python.split(".")
    kilobytes = sum(file.lstat().st_size for file in tree.rglob("*")) // 1024
    control = (HERE / "control").read_text()
    for key, value in {
        "VERSION": version,
        "ARCHITECTURE": architecture,
        "KILOBYTES": str(kilobytes),
        "PYTHON": python,
        "NEXT": f"{major}.{int(minor) + 1}",
    }.items():
        control = control.replace(f"@{key}@", value)
    _write(tree / "DEBIAN/control", control)
    _write(tree / "DEBIAN/md5sums", "".join(_sums(tree)))
    deb = out / f"ropeway_{version}_{architecture}.deb"
    subprocess.run(["dpkg-deb", "--root-owner-group", "-Zxz", "-z1", "--build", str(tree), str(deb)], check=True)
    return deb


def _install(wheel: Path, architecture: str, python: str, site: Path) -> None:
    """Unpack the wheels of an architecture: what pip takes for that Python here, but for what is not for the other."""
    report = site.parents[4] / "report.json"
    site.mkdir(parents=True)
    chosen_for = ["--only-binary=:all:", f"--python-version={python}"]
    ask = ["install", "--dry-run", "--ignore-installed", "--report", str(report), *chosen_for]
    _pip(*ask, f"{wheel}[{','.join(EXTRAS)}]")
    chosen = {item["metadata"]["name"]: item["metadata"] for item in json.loads(report.read_text())["install"]}
    report.unlink()
    machine = MACHINES[architecture]
    full = PYTHON_OF_DEBIAN if PYTHON_OF_DEBIAN.startswith(f"{python}.") else f"{python}.0"
    target = {
        "platform_machine": machine,
        "python_version": python,
        "python_full_version": full,
        "sys_platform": "linux",
    }
    pinned = sorted(set(_needed("ropeway", chosen, target)))
    platforms = [f"--platform=manylinux_{glibc}_{machine}".replace("_2014_", "2014_") for glibc in GLIBCS]
    common = ["--no-deps", "--only-binary=:all:", f"--python-version={python}", "--target", str(site), *platforms]
    _pip("install", *common, str(wheel), *pinned)


def _needed(name: str, chosen: dict[str, dict[str, object]], target: dict[str, str]) -> Iterator[str]:
    """Yield what ``name`` needs on the target, in the version chosen here, or any that fits if none is needed here."""
    names = {_plain(known): known for known in chosen}
    seen, waiting = set(), [Requirement(name)]
    while waiting:
        wanted = waiting.pop()
        known = names.get(_plain(wanted.name))
        if wanted.name != name:
            yield f"{wanted.name}{wanted.specifier}" if known is None else f"{known}=={chosen[known]['version']}"
        if known is None or known in seen:
            continue
        seen.add(known)
        for text in chosen[known].get("requires_dist", ()):  # type: ignore[attr-defined]
            requirement = Requirement(text)
            marker = requirement.marker
            if marker is None or any(marker.evaluate({**target, "extra": extra}) for extra in ("", *EXTRAS)):
                waiting.append(requirement)


def _plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _write(file: Path, text: str, *, executable: bool = False) -> None:
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_text(text, "utf-8")
    file.chmod(0o755 if executable else 0o644)


def _sums(tree: Path) -> Iterator[str]:
    for file in sorted(tree.rglob("*")):
        if file.is_file() and not file.is_symlink() and "DEBIAN" not in file.relative_to(tree).parts:
            digest = hashlib.md5(file.read_bytes(), usedforsecurity=False).hexdigest()
            yield f"{digest}  {file.relative_to(tree)}\n"


if __name__ == "__main__":
    main()
