"""Fleets, and the bundles of their members."""

from __future__ import annotations

import json
import stat
from pathlib import Path

import pytest

from ropeway.errors import IdentityError
from ropeway.overlay.fleet import Fleet, make_request, new_key, valid_name
from ropeway.overlay.identity import Identity, private_pem, write_private
from ropeway.overlay.rights import EVERYTHING, Rights
from ropeway.overlay.trust import Trust


def mode(path: Path) -> int:
    return stat.S_IMODE(path.stat().st_mode)


@pytest.mark.parametrize("algorithm", ["ed25519", "rsa"])
def test_a_fleet(tmp_path: Path, algorithm: str) -> None:
    """A fleet issues members whose signatures its certificates verify; secrets are for their owner only."""
    made = Fleet.create("acme", tmp_path / "acme", algorithm=algorithm, routers=["tls/r:7447"])
    assert mode(tmp_path / "acme") == 0o700
    assert mode(tmp_path / "acme" / "ca.key") == mode(tmp_path / "acme" / "name.secret") == 0o600
    robot = made.issue("robot1", rights=Rights(publish=("/a",)))
    assert (robot.name, robot.fleet, robot.routers) == ("robot1", "acme", ("tls/r:7447",))
    assert robot.name_secret == made.name_secret
    assert len(made.name_secret) == 32
    found = Trust(robot.ca, robot.crl).check(robot.certificate.der)
    assert found.rights == Rights(publish=("/a",))
    assert found.verify_signature(b"text", robot.sign(b"text"))
    assert not found.verify_signature(b"other", robot.sign(b"text"))
    assert made.issue("cloud").certificate.rights == EVERYTHING
    assert [row["name"] for row in Fleet(tmp_path / "acme").issued()] == ["robot1", "cloud"]


def test_routers_know_no_names(tmp_path: Path) -> None:
    """The bundle of a router has no name secret and no rights."""
    router = Fleet.create("f", tmp_path / "f").issue("r1", role="router", routers=["tls/x:1"])
    assert router.name_secret is None
    assert router.certificate.rights == Rights()
    assert router.routers == ("tls/x:1",)
    assert Identity.parse(router.to_text(), "r1").name_secret is None


def test_bundles(tmp_path: Path) -> None:
    """A bundle is one file for its owner only, is read as it was written, and is never overwritten."""
    made = Fleet.create("f", tmp_path / "f")
    robot = made.issue("robot1")
    path = tmp_path / "robot1.ropeway"
    write_private(path, robot.to_text())
    assert mode(path) == 0o600
    found = Identity.load(path)
    assert (found.certificate.der, found.name_secret, found.crl) == (
        robot.certificate.der,
        robot.name_secret,
        made.crl_der(),
    )
    assert set(found.tls()) == {
        "root_ca_certificate_base64",
        "listen_certificate_base64",
        "listen_private_key_base64",
        "connect_certificate_base64",
        "connect_private_key_base64",
    }
    with pytest.raises(IdentityError, match="never overwritten"):
        write_private(path, "")
    write_private(path, made.renew("robot1").to_text(), replace=True)
    assert mode(path) == 0o600
    assert Identity.load(path).certificate.serial != robot.certificate.serial


def test_damaged_bundles(tmp_path: Path) -> None:
    """A bundle that is missing, damaged, of a newer version or put together wrongly says what to do."""
    made = Fleet.create("f", tmp_path / "f")
    good = json.loads(made.issue("robot1").to_text())
    other = json.loads(made.issue("robot2").to_text())
    cases = {
        "no such bundle": None,
        "it is no bundle": "certainly not",
        "newer ropeway": json.dumps({**good, "ropeway": 2}),
        "keys join": json.dumps({k: v for k, v in good.items() if k != "key"}),
        "it is damaged": json.dumps({**good, "certificate": "x"}),
        "have a new one issued": json.dumps({**good, "name_secret": "zz"}),
        "do not go together": json.dumps({**good, "key": other["key"]}),
    }
    for said, text in cases.items():
        path = tmp_path / f"{len(said)}.ropeway"
        if text is not None:
            path.write_text(text)
        with pytest.raises(IdentityError, match=said):
            Identity.load(path)


def test_requests(tmp_path: Path) -> None:
    """A machine that keeps its key gets a bundle without one; a bad request is refused."""
    made = Fleet.create("f", tmp_path / "f")
    key = new_key("ed25519")
    text = made.sign_request(make_request("robot1", key).encode(), rights=Rights(call=("*",)))
    assert "PRIVATE" not in text
    identity = Identity.parse(json.dumps({**json.loads(text), "key": private_pem(key)}), "robot1")
    assert identity.name == "robot1"
    assert identity.certificate.rights == Rights(call=("*",))
    for bad in (b"", b"-----BEGIN CERTIFICATE REQUEST-----\nAAAA\n-----END CERTIFICATE REQUEST-----\n"):
        with pytest.raises(IdentityError, match="signing request"):
            made.sign_request(bad)
    with pytest.raises(IdentityError, match="has a certificate already"):
        made.sign_request(make_request("robot1", key).encode())


def test_names_and_places(tmp_path: Path) -> None:
    """A name twice, a bad name, a fleet in a place that is taken and one that is none are refused."""
    made = Fleet.create("f", tmp_path / "f")
    made.issue("robot1")
    with pytest.raises(IdentityError, match="has a certificate already"):
        made.issue("robot1")
    for name in ("", "-x", "a/b", "ä", "x" * 64):
        with pytest.raises(IdentityError):
            valid_name(name)
    with pytest.raises(IdentityError, match="exists already"):
        Fleet.create("f", tmp_path / "f")
    with pytest.raises(IdentityError, match="keys init"):
        Fleet(tmp_path)
    with pytest.raises(IdentityError, match="issued to: robot1"):
        made.revoke("robot2")
    assert len(made.revoke("robot1")) == 1
    with pytest.raises(IdentityError, match="revoked already"):
        made.revoke("robot1")
    with pytest.raises(IdentityError, match="ed25519, rsa"):
        Fleet.create("g", tmp_path / "g", algorithm="dsa")
    assert not (tmp_path / "g").exists()
