"""Provides what the verbs of ``ropeway keys`` share."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Any

import typer

from ropeway.errors import IdentityError
from ropeway.networks.overlay.crypto.certificate import Certificate
from ropeway.networks.overlay.fleet import Fleet
from ropeway.networks.overlay.rights import VERBS, Rights

__all__ = [
    "ConnectOption",
    "DaysOption",
    "FleetOption",
    "MayCall",
    "MayOffer",
    "MayPublish",
    "MaySubscribe",
    "RouterOption",
    "about",
    "describe",
    "open_fleet",
    "rights_of",
]

FleetOption = Annotated[
    Path | None,
    typer.Option("--fleet", help="The directory of the fleet; by default, the one here.", show_default=False),
]
RouterOption = Annotated[
    bool, typer.Option("--router", help="Issue it to a router, which carries everything and reads nothing.")
]
DaysOption = Annotated[float, typer.Option("--days", min=0.0001, help="How long the certificate is valid.")]
ConnectOption = Annotated[
    list[str] | None,
    typer.Option(
        "--connect", help="A router, as in tls/router.example:7447; by default, those of the fleet.", show_default=False
    ),
]
_NAMES = "a pattern of topics, as in '/camera/*'"
MayPublish = Annotated[
    list[str] | None,
    typer.Option("--may-publish", help=f"May publish {_NAMES}; may be repeated.", show_default=False),
]
MaySubscribe = Annotated[
    list[str] | None, typer.Option("--may-subscribe", help=f"May read {_NAMES}.", show_default=False)
]
MayCall = Annotated[
    list[str] | None,
    typer.Option("--may-call", help="May call a pattern of services and actions.", show_default=False),
]
MayOffer = Annotated[
    list[str] | None,
    typer.Option("--may-offer", help="May serve a pattern of services and actions.", show_default=False),
]


def open_fleet(directory: Path | None) -> Fleet:
    """Open the fleet in a directory, or the only one below this one. Raises ``IdentityError``."""
    if directory is not None:
        return Fleet(directory)
    if Path("ca.key").exists():
        return Fleet(Path())
    found = sorted(path.parent for path in Path().glob("*/ca.key"))
    if len(found) != 1:
        names = f"{len(found)} fleets are here: {', '.join(map(str, found))}" if found else "there is no fleet here"
        raise IdentityError("--fleet", f"{names}; name its directory, or make one with: ropeway keys init NAME")
    return Fleet(found[0])


def rights_of(
    publish: list[str] | None, subscribe: list[str] | None, call: list[str] | None, offer: list[str] | None
) -> Rights | None:
    """Return the rights that the options give; ``None`` without any, which gives everything."""
    given = dict(zip(VERBS, (publish, subscribe, call, offer), strict=True))
    if not any(given.values()):
        return None
    for patterns in given.values():
        for pattern in patterns or ():
            if not pattern.startswith(("/", "*")):
                raise IdentityError(pattern, "a pattern is of absolute names, as in '/camera/*'")
    return Rights(**{verb: tuple(patterns or ()) for verb, patterns in given.items()})


def about(certificate: Certificate) -> dict[str, Any]:
    """Return the content of a certificate, as JSON."""
    rights = certificate.rights
    return {
        "name": certificate.name,
        "role": certificate.role,
        "serial": f"{certificate.serial:x}",
        "fingerprint": certificate.fingerprint.hex(),
        "not_before": certificate.not_before.isoformat(),
        "not_after": certificate.not_after.isoformat(),
        "rights": {verb: list(getattr(rights, verb)) for verb in VERBS} if certificate.role == "member" else {},
    }


def describe(certificate: Certificate) -> str:
    """Return the content of a certificate, for people."""
    lines = [
        f"name          {certificate.name} ({certificate.role})",
        f"valid until   {certificate.not_after:%Y-%m-%d %H:%M} UTC",
        f"fingerprint   {certificate.fingerprint.hex()}",
    ]
    if certificate.role == "member":
        patterns = ((verb, ", ".join(getattr(certificate.rights, verb)) or "nothing") for verb in VERBS)
        lines += [f"may {verb:<10}{names}" for verb, names in patterns]
    return "\n".join(lines)
