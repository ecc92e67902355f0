"""ropeway.extras: what only some users need says so where it is not installed."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest

from ropeway import extras
from ropeway.errors import MissingExtra
from ropeway.extras import EXTRAS, needing, require

ROOT = Path(__file__).parents[1]


def test_extras_are_those_of_the_package() -> None:
    """Every extra that an error names is one of the package, and the other way round."""
    table = (ROOT / "pyproject.toml").read_text().partition("[project.optional-dependencies]")[2].partition("\n[")[0]
    assert set(re.findall(r"^(\w+) =", table, re.MULTILINE)) == {*EXTRAS, "all"}
    (everything,) = re.findall(r"ropeway\[([\w,]+)\]", table)
    assert everything.split(",") == sorted(EXTRAS)


@pytest.mark.parametrize("file", ["deploy/Containerfile", "deploy/debian/build.py", ".ci/arm64"])
def test_extras_of_services(file: str) -> None:
    """Images and packages lack nothing that a gateway may be configured to use: all extras but those that draw."""
    (found,) = re.findall(r"\[([\w,]+)\]['\"]|^EXTRAS = \((.+)\)", (ROOT / file).read_text(), re.MULTILINE)
    assert set(re.findall(r"\w+", "".join(found))) == EXTRAS.keys() - {"dashboard", "demo"}


@pytest.mark.parametrize("extra", EXTRAS)
def test_what_is_missing_is_one_sentence(extra: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What needs an extra that is not installed says which, and how to install it."""
    require(extra, "this test")
    monkeypatch.setattr(extras, "find_spec", lambda _: None)
    with pytest.raises(MissingExtra, match=re.escape(f"pip install 'ropeway[{extra}]'")) as caught:
        require(extra, "this test")
    assert (caught.value.extra, caught.value.purpose) == (extra, "this test")


@pytest.mark.parametrize(
    "words",
    [
        ("predict", "--topic", "/odom,bytes=720,hz=20", "--mbit", "20"),
        ("topic", "list", "-g", "memory:here", "--spin-time", "0"),
        ("doctor",),
        ("keys", "init", "fleet"),
    ],
    ids=lambda words: words[0],
)
def test_verbs_that_need_none(words: tuple[str, ...], tmp_path: Path) -> None:
    """Verbs run where no extra is installed, as long as nothing is asked of them that one brings."""
    code = (
        "import sys; from ropeway.extras import EXTRAS; "
        "sys.modules.update({module: None for modules in EXTRAS.values() for module in modules}); "
        "from ropeway.cli import main; main()"
    )
    done = subprocess.run([sys.executable, "-c", code, *words], cwd=tmp_path, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_an_import_that_fails() -> None:
    """An import that fails for the lack of an extra names it; any other failure stays what it is."""
    with pytest.raises(MissingExtra, match=r"^a test needs .* 'ropeway\[overlay\]'$"), needing("a test"):
        raise ModuleNotFoundError("No module named 'zenoh.handlers'", name="zenoh.handlers")
    with pytest.raises(ModuleNotFoundError), needing("a test"):
        raise ModuleNotFoundError("No module named 'numby'", name="numby")
