"""Fleets, and the bundles of their members."""

from __future__ import annotations

import base64
import contextlib
import json
import os
import stat
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
from cryptography import x509
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.serialization import Encoding
from cryptography.x509.oid import NameOID

from ropeway.errors import IdentityError
from ropeway.networks.overlay import fleet as fleet_module
from ropeway.networks.overlay.crypto.identity import Identity, private_pem, write_private
from ropeway.networks.overlay.crypto.trust import Trust
from ropeway.networks.overlay.durable import write_durable
from ropeway.networks.overlay.fleet import Fleet, make_request, new_key, valid_name
from ropeway.networks.overlay.rights import EVERYTHING, Rights


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


def test_files_that_others_can_read(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    """A key that others can read is refused with the command that mends it; one of another owner is told of."""
    made = Fleet.create("f", tmp_path / "f")
    path = tmp_path / "robot1.ropeway"
    write_private(path, made.issue("robot1").to_text())
    for readable in (0o640, 0o604, 0o660, 0o644):
        path.chmod(readable)
        with pytest.raises(IdentityError, match=f"mode {readable:04o}.*chmod 600 {path}"):
            Identity.load(path)
    monkeypatch.setenv("CREDENTIALS_DIRECTORY", str(tmp_path))  # a service manager has put it there
    assert Identity.load(path).name == "robot1"
    monkeypatch.delenv("CREDENTIALS_DIRECTORY")
    monkeypatch.setattr(os, "geteuid", lambda: path.stat().st_uid + 1)  # a secret that a container has mounted
    assert Identity.load(path).name == "robot1"
    assert "others can read it (mode 0644)" in caplog.text
    monkeypatch.undo()
    path.chmod(0o400)
    assert Identity.load(path).name == "robot1"
    for name in ("ca.key", "name.secret"):
        (tmp_path / "f" / name).chmod(0o644)
        with pytest.raises(IdentityError, match=f"chmod 600 .*{name}"):
            Fleet(tmp_path / "f")
        (tmp_path / "f" / name).chmod(0o600)
    assert Fleet(tmp_path / "f").ca == made.ca


def test_damaged_bundles(tmp_path: Path) -> None:
    """A bundle that is missing, damaged, of a newer version or put together wrongly says what to do."""
    made = Fleet.create("f", tmp_path / "f")
    good = json.loads(made.issue("robot1").to_text())
    other = json.loads(made.issue("robot2").to_text())
    unknown_kind = good["key"].replace("MC4CAQAwBQYDK2Vw", "MC4CAQAwBQYDK2V5")  # another number for its algorithm
    der = base64.b64decode("".join(good["certificate"].splitlines()[1:-1])).replace(b"\xa0\3\2\1\2", b"\xa0\3\2\1\x1a")
    odd_version = f"-----BEGIN CERTIFICATE-----\n{base64.encodebytes(der).decode()}-----END CERTIFICATE-----\n"
    cases = {
        "no such bundle": None,
        "it is not a bundle": "certainly not",
        "newer ropeway": json.dumps({**good, "ropeway": 2}),
        "keys join": json.dumps({k: v for k, v in good.items() if k != "key"}),
        "it is damaged": json.dumps({**good, "certificate": "x"}),
        "have a new one issued": json.dumps({**good, "name_secret": "zz"}),
        "damaged .*key": json.dumps({**good, "key": unknown_kind}),
        "damaged .*version": json.dumps({**good, "certificate": odd_version}),
        r"it is not a bundle; ": "[" * 5000,
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


def test_damaged_requests(tmp_path: Path) -> None:
    """A request is refused with an error of ours, whatever byte of it is damaged, and however.

    All but one: how many bits of the signature are unused changes nothing that is signed.
    """
    made = Fleet.create("f", tmp_path / "f")
    der = base64.b64decode("".join(make_request("robot1", new_key("ed25519")).splitlines()[1:-1]))
    refused = 0
    unused_bits_at = len(der) - 64 - 1
    for at in range(len(der)):
        if at == unused_bits_at:
            continue
        for value in (0x00, 0x1A, der[at] ^ 0x80, der[at] ^ 1):
            raw = base64.encodebytes(der[:at] + bytes((value,)) + der[at + 1 :])
            pem = b"-----BEGIN CERTIFICATE REQUEST-----\n" + raw + b"-----END CERTIFICATE REQUEST-----\n"
            if value != der[at]:
                with pytest.raises(IdentityError):
                    made.sign_request(pem)
                refused += 1
    assert refused > len(der)
    assert made.issued() == []


def test_requests_with_other_keys(tmp_path: Path) -> None:
    """A request with a key of a kind that the overlay does not know is refused, and says which it knows."""
    made = Fleet.create("f", tmp_path / "f")
    key = ec.generate_private_key(ec.SECP256R1())
    subject = x509.Name([x509.NameAttribute(NameOID.COMMON_NAME, "robot1")])
    request = x509.CertificateSigningRequestBuilder().subject_name(subject).sign(key, hashes.SHA256())
    with pytest.raises(IdentityError, match="neither Ed25519 nor RSA"):
        made.sign_request(request.public_bytes(Encoding.PEM))


@pytest.mark.parametrize("name", ["ca.pem", "ca.key", "name.secret", "crl.pem", "fleet.json"])
@pytest.mark.parametrize(
    "text",
    [
        b"",
        b"\xff\xfe",
        b"{}",
        b"[" * 5000,
        b'{"routers": [], "issued": 5}',
        b'{"routers": [], "issued": [{"name": "a"}]}',
        b'{"routers": [1], "issued": []}',
    ],
)
def test_damaged_fleets(tmp_path: Path, name: str, text: bytes) -> None:
    """A fleet one of whose files is damaged is refused as a whole, and says that it is no fleet."""
    Fleet.create("f", tmp_path / "f")
    (tmp_path / "f" / name).write_bytes(text)
    with pytest.raises(IdentityError, match="not the directory of a fleet"):
        Fleet(tmp_path / "f")


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


ISSUE = """
import sys
from pathlib import Path
from ropeway.networks.overlay.fleet import Fleet
fleet = Fleet(Path(sys.argv[1]))
sys.stdin.readline()
for number in range(3):
    print(fleet.issue(f"{sys.argv[2]}-{number}").certificate.serial)
"""


def test_many_at_once(tmp_path: Path) -> None:
    """What several processes issue at the same time is all recorded, and all of it can be revoked."""
    made = Fleet.create("f", tmp_path / "f")
    command = [sys.executable, "-c", ISSUE, str(made.directory)]
    issuers = [
        subprocess.Popen([*command, f"n{n}"], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True)
        for n in range(4)
    ]
    for issuer in issuers:
        assert issuer.stdin is not None
        issuer.stdin.write("go\n")
        issuer.stdin.flush()
    serials = {int(line) for issuer in issuers for line in issuer.communicate()[0].split()}
    assert len(serials) == 12
    assert {row["serial"] for row in Fleet(made.directory).issued()} == serials
    revoked = {serial for n in range(4) for number in range(3) for serial in made.revoke(f"n{n}-{number}")}
    assert revoked == serials
    assert {entry.serial_number for entry in Fleet(made.directory).crl} == serials


@pytest.mark.parametrize("operation", ["issue", "renew", "revoke", "sign"])
def test_a_crash_in_the_middle(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, operation: str) -> None:
    """Wherever a change is broken off, the fleet opens, no certificate was handed out unrecorded, and it can go on."""
    csr = make_request("guest", new_key("ed25519")).encode()
    write = write_durable
    for steps in range(4):
        made = Fleet.create("f", tmp_path / f"f{steps}")
        made.issue("robot1")
        made.issue("gone")
        made.revoke("gone")
        left = steps

        def crash(path: Path, data: bytes) -> None:
            nonlocal left
            if left == 0:
                raise KeyboardInterrupt
            left -= 1
            write(path, data)

        work = {
            "issue": lambda: made.issue("gone"),  # noqa: B023
            "renew": lambda: made.renew("robot1"),  # noqa: B023
            "revoke": lambda: made.revoke("robot1"),  # noqa: B023
            "sign": lambda: made.sign_request(csr),  # noqa: B023
        }[operation]
        with monkeypatch.context() as patch:
            patch.setattr(fleet_module, "write_durable", crash)
            handed: Any = None
            with contextlib.suppress(KeyboardInterrupt):
                handed = work()
        again = Fleet(made.directory)
        recorded = {row["serial"] for row in again.issued()}
        if isinstance(handed, Identity):
            assert handed.certificate.serial in recorded
        again.issue("next")
        if not again.is_revoked("robot1"):
            again.revoke("robot1")
        listed = {entry.serial_number for entry in Fleet(made.directory).crl}
        assert {row["serial"] for row in again.issued() if row["name"] == "robot1"} <= listed


def test_a_fleet_is_made_whole_or_not_at_all(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A fleet whose making fails leaves nothing behind."""

    def fail(path: Path, data: bytes) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(fleet_module, "write_durable", fail)
        with pytest.raises(IdentityError, match="No space left"):
            Fleet.create("f", tmp_path / "f")
    assert not list(tmp_path.iterdir())
    Fleet.create("f", tmp_path / "f")


def test_renewing_who_is_revoked(tmp_path: Path) -> None:
    """A member that was revoked is not let in again by renewing it, only by issuing it anew."""
    made = Fleet.create("f", tmp_path / "f")
    made.issue("robot1")
    made.revoke("robot1")
    with pytest.raises(IdentityError, match="keys issue"):
        made.renew("robot1")
    made.issue("robot1")
    assert not made.is_revoked("robot1")
