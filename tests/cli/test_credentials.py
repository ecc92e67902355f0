"""ropeway.cli.credentials: any verb on a graph can say who asks."""

from __future__ import annotations

import asyncio
import subprocess
import sys
from contextlib import AsyncExitStack
from pathlib import Path

import pytest

from ropeway import aio
from ropeway.gateway.config import config
from ropeway.gateway.gateway import Gateway
from tests.cli.conftest import Ropeway
from tests.support.authority import Authority
from tests.support.until import PATIENCE_S

TOKEN = "a-token-of-this-test"


async def run(environment: dict[str, str], *arguments: str, **more: str) -> subprocess.CompletedProcess[str]:
    """Run the command beside the gateway of the test."""
    process = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "ropeway", *arguments, stdout=-1, stderr=-1, env={**environment, **more}
    )
    async with aio.timeout(PATIENCE_S):
        out, err = await process.communicate()
    return subprocess.CompletedProcess(arguments, process.returncode or 0, out.decode(), err.decode())


async def test_token_and_certificates(
    stack: AsyncExitStack, environment: dict[str, str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """A gateway that asks for a token or a certificate answers who shows one, and nothing shows the token."""
    monkeypatch.setenv("TOKEN", TOKEN)
    authority = Authority(tmp_path, "ours")
    server, own = authority.sign("cloud"), authority.sign("robot")
    settings = {
        "graphs": ["memory:credentials"],
        "listen": ["wss://127.0.0.1:0"],
        "tls": {**server, "ca": authority.file, "client_certificates": "optional"},
        "auth": {
            "tokens": [{"token": {"env": "TOKEN"}, "role": "all"}],
            "certificates": [{"common_name": "robot", "role": "all"}],
            "roles": {"all": {}},
        },
    }
    gateway = Gateway(config.parse({"gateway": {"name": "cloud", **settings}, "remotes": []}))
    await stack.enter_async_context(gateway)
    asked = ("node", "list", "--spin-time", "1", "-g", f"wss://127.0.0.1:{gateway.servers[0].listeners[0].port}")
    shown = ("--certificate", own["certificate"], "--key", own["key"])
    trusting, certified, nobody, stranger = await asyncio.gather(
        run(environment, *asked, "--ca", authority.file, ROPEWAY_TOKEN=TOKEN),
        run(environment, *asked, "--ca", authority.file, *shown),
        run(environment, *asked, "--ca", authority.file),
        run(environment, *asked, "--token", TOKEN),
    )
    assert [trusting.returncode, certified.returncode, nobody.returncode, stranger.returncode] == [0, 0, 1, 1]
    assert "certificate" in stranger.stderr
    assert not any(TOKEN in told.stdout + told.stderr for told in (trusting, certified, nobody, stranger))


@pytest.mark.parametrize(
    ("options", "told"),
    [
        (["-g", "memory:x", "--ca", "x.pem"], "are for wss://, iorts:// and mqtts:// graphs"),
        (["-g", "wss://127.0.0.1:1", "--ca", "no.pem"], "there is no file no.pem"),
        (["-g", "wss://127.0.0.1:1", "--key", __file__], "--key needs --certificate"),
        (["-g", "wss://127.0.0.1:1", "--ca", __file__], "holds no certificates"),
    ],
)
def test_options_that_cannot_be(in_process: Ropeway, options: list[str], told: str) -> None:
    """Files that are not there, and options for a graph that takes none, end with a sentence."""
    ended = in_process("topic", "list", *options)
    assert ended.returncode == 2
    assert told in ended.stderr


def test_an_option_is_for_one_run(in_process: Ropeway) -> None:
    """What one run of a verb was given is not left for the next."""
    assert in_process("topic", "list", "-g", "memory:x", "--ca", "x.pem").returncode == 2
    assert in_process("topic", "list", "-g", "memory:x", "--spin-time", "0").returncode == 0
