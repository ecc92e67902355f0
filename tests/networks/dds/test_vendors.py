"""Whose requests are like ours."""

from __future__ import annotations

from ropeway.networks.dds.vendors import speaks_header, vendor_name


def test_speaks_header() -> None:
    """Only endpoints of Cyclone DDS put our header in front."""
    assert speaks_header(b"\x01\x10" + bytes(14))
    assert not speaks_header(b"\x01\x0f" + bytes(14))
    assert not speaks_header(b"")


def test_names() -> None:
    """People are told the name of a vendor, or its number."""
    assert vendor_name(b"\x01\x0f" + bytes(14)) == "Fast DDS"
    assert vendor_name(b"\x01\x7f" + bytes(14)) == "DDS vendor 01.7f"
