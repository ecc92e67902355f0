"""``ropeway dashboard``: where it listens, and whom it lets in."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.conftest import Ropeway


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (["--address", "0.0.0.0"], "choose a key with --key-file, or say --insecure"),
        (["--certfile", "a.pem"], "--certfile and --keyfile belong together"),
        (["--key-file", "no such file"], "No such file"),
        (["--key-file", "short"], "at least 16 characters"),
        (["no such gateway"], "no gateway of this name runs here"),
        (["--certfile", "short", "--keyfile", "short"], "--certfile"),
    ],
)
def test_what_is_refused(
    ropeway: Ropeway, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, options: list[str], said: str
) -> None:
    """Other machines are not let in by mistake, and each option that is wrong is named with what to do."""
    monkeypatch.chdir(tmp_path)
    Path("short").write_text("short")
    refused = ropeway("dashboard", "--port", "0", *options)
    assert refused.returncode in (1, 2)
    assert said in refused.stderr
    assert "Traceback" not in refused.stderr
