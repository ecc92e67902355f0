"""Finds the program ``ropeway``."""

import importlib.util
import os
import shutil
import sys

__all__ = ["NotInstalled", "command", "without_ros_arguments"]


class NotInstalled(Exception):
    """There is no Ropeway on this machine, as far as can be seen."""

    def __init__(self):
        super().__init__("ropeway is not installed: pip install ropeway, or name the program in the variable ROPEWAY")


def command(*arguments):
    """Return the command line of ``ropeway`` with ``arguments``. Raises ``NotInstalled``.

    It is taken from this Python, or where it has none, from the PATH; the variable ROPEWAY names another.
    """
    program = os.environ.get("ROPEWAY")
    if program is None:
        found = importlib.util.find_spec("ropeway")
        if found is not None and found.origin is not None:
            start = "from ropeway.cli import main; main()"
            return [sys.executable, "-c", start, *arguments]
        program = shutil.which("ropeway")
    if program is None:
        raise NotInstalled
    return [program, *arguments]


def without_ros_arguments(arguments):
    """Return ``arguments`` but for those between ``--ros-args`` and ``--``, which launch files add."""
    kept, inside = [], False
    for argument in arguments:
        if argument == "--ros-args":
            inside = True
        elif inside and argument == "--":
            inside = False
        elif not inside:
            kept.append(argument)
    return kept
