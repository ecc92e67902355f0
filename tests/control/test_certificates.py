"""The control API over TCP with certificates of clients in place of tokens."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import httpx
import pytest

from ropeway.control.client import find_target
from ropeway.errors import ControlUnavailable
from tests.control.conftest import Begin, Controlled
from tests.support.authority import Authority


async def secured(begin: Begin, ours: Authority, **tls: Any) -> Controlled:
    """Begin a gateway that knows its operator by a certificate."""
    auth = {
        "certificates": [{"common_name": "operator", "role": "operator"}],
        "roles": {"operator": {"control": ["observe"]}},
    }
    settings = {**ours.sign("gateway"), "ca": ours.file, **tls}
    return await begin(control={"listen": ["https://127.0.0.1:0"]}, tls=settings, auth=auth)


def file_of(authority: Authority, name: str) -> str:
    """Return one file with a certificate and its key."""
    parts = authority.sign(name)
    path = authority.directory / f"{name}.both.pem"
    path.write_text(Path(parts["certificate"]).read_text() + Path(parts["key"]).read_text())
    return str(path)


async def test_a_certificate_has_the_rights_of_its_role(begin: Begin, tmp_path: Path) -> None:
    """Who shows a certificate that the configuration names has the rights of its role, and no more."""
    ours = Authority(tmp_path, "ours")
    made = await secured(begin, ours)
    target = find_target(made.control.addresses[0], ca=ours.file, cert=file_of(ours, "operator"))
    async with target.async_client() as operator:
        assert (await operator.get("/v1/status")).status_code == 200
        assert (await operator.get("/v1/config")).status_code == 403


async def test_another_certificate(begin: Begin, tmp_path: Path) -> None:
    """A certificate of our authority that the configuration does not name gets nothing, with a sentence."""
    ours = Authority(tmp_path, "ours")
    made = await secured(begin, ours)
    target = find_target(made.control.addresses[0], ca=ours.file, cert=file_of(ours, "visitor"))
    async with target.async_client() as visitor:
        answer = await visitor.get("/v1/status")
    assert answer.status_code == 401
    assert answer.json()["error"]


async def test_without_a_certificate(begin: Begin, tmp_path: Path) -> None:
    """Without a certificate, or with one of another authority, there is no connection at all."""
    (tmp_path / "theirs").mkdir()
    ours, strangers = Authority(tmp_path, "ours"), Authority(tmp_path / "theirs", "strangers")
    made = await secured(begin, ours)
    for cert in ("", file_of(strangers, "operator")):
        async with find_target(made.control.addresses[0], ca=ours.file, cert=cert).async_client() as client:
            with pytest.raises(httpx.TransportError):
                await client.get("/v1/status")
    assert (await made.client.get("/v1/status")).status_code == 200


def test_a_file_that_is_no_certificate(tmp_path: Path) -> None:
    """A file without a certificate, or none, is an error that names it."""
    (tmp_path / "cert.pem").write_text("no certificate")
    for name in ("cert.pem", "missing.pem"):
        with pytest.raises(ControlUnavailable, match=name):
            find_target("https://127.0.0.1:1", cert=str(tmp_path / name))
