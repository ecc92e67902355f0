"""ropeway.gateway.credentials."""

from __future__ import annotations

from pathlib import Path

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config.config import parse
from ropeway.gateway.credentials import Credentials, read_credentials


def read(address: str, directory: Path, **remote: object) -> Credentials:
    document = {"gateway": {"graphs": ["memory:x"], "listen": []}, "remotes": [{"address": address, **remote}]}
    return read_credentials(parse(document, directory=directory).remotes[0], 0)


def test_nothing_to_show(tmp_path: Path) -> None:
    """A remote without a token or certificates is shown nothing."""
    for address in ("ws://cloud:9090", "wss://cloud:9090"):
        found = read(address, tmp_path)
        assert (found.context, found.token, found.headers) == (None, None, {})


def test_token(tmp_path: Path, caplog: pytest.LogCaptureFixture) -> None:
    """A token is read from its file and shown; that it is sent unencrypted is said, but not within this machine."""
    (tmp_path / "token").write_text("secret\n")
    for address in ("ws://127.0.0.1:9090", "wss://cloud:9090"):
        found = read(address, tmp_path, token={"file": "token"})
        assert found.headers == {"Authorization": "Bearer secret"}
    assert caplog.messages == []
    read("ws://cloud:9090", tmp_path, token={"file": "token"})
    assert caplog.messages == ["ws://cloud:9090: the token is sent unencrypted; wss:// would encrypt it"]


def test_missing_file(tmp_path: Path) -> None:
    """A token whose file is not there is an error that names its place in the configuration."""
    with pytest.raises(ConfigError, match=r"remotes\[0\]\.token"):
        read("ws://cloud:9090", tmp_path, token={"file": "nowhere"})
