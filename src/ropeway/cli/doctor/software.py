"""Looks at the software: Python, Ropeway and its extras, the DDS library."""

from __future__ import annotations

import platform
import sys
from collections.abc import Iterator
from importlib.util import find_spec

from ropeway import __version__
from ropeway.cli.doctor.symptom import Symptom
from ropeway.extras import EXTRAS

__all__ = ["software"]


def software() -> Iterator[Symptom]:
    """Yield what there is to say of the installation."""
    python = ".".join(map(str, sys.version_info[:3]))
    yield Symptom(True, "version", f"Ropeway {__version__}, Python {python}, {platform.system()} {platform.machine()}")
    for extra, modules in EXTRAS.items():
        missing = [module for module in modules if find_spec(module) is None]
        if missing:
            yield Symptom(
                None,
                "extras",
                f"the extra {extra} is not installed ({', '.join(missing)})",
                f"if you need it: pip install 'ropeway[{extra}]'",
            )
    yield _dds()


def _dds() -> Symptom:
    from ropeway.networks.dds.library import LibraryMissing, find

    try:
        found = find()
    except LibraryMissing as error:
        return Symptom(
            None,
            "dds",
            f"there is no Cyclone DDS library, so there are no dds graphs: {error}",
            "install cyclonedds (pip, where it has a wheel), a ROS 2, or Debian's cyclonedds-tools",
        )
    return Symptom(True, "dds", f"Cyclone DDS {found.version or 'of an unknown version'} ({found.path})")
