"""Prints what verbs say: results to stdout, everything else as sentences to stderr; defines the exit codes.

0 is success, 1 failure, 2 a wrong command line or configuration, 130 an interruption.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final, NoReturn

from ropeway.aio import BaseExceptionGroup
from ropeway.errors import ConfigError, RopewayError

__all__ = ["MARKS", "answer", "complain", "fail", "print_json", "reported"]

MARKS: Final = {True: "ok", False: "NO", None: " ?"}
"""Marks of findings: right, wrong, and not known or not decisive."""


def print_json(value: Any) -> None:
    """Print one value on one line, at once, so that a reader of a pipe sees it."""
    import orjson

    sys.stdout.write(orjson.dumps(value, option=orjson.OPT_SERIALIZE_NUMPY | orjson.OPT_NON_STR_KEYS).decode() + "\n")
    sys.stdout.flush()


def answer(text: str) -> None:
    """Print a line (or several) of the result, at once."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def complain(text: str) -> None:
    """Print a sentence for the person at the terminal."""
    sys.stderr.write(text + "\n")
    sys.stderr.flush()


def fail(text: str, code: int = 1) -> NoReturn:
    """Say why and end with ``code``."""
    complain(f"ropeway: {text}")
    raise _ended(code)


def _ended(code: int) -> RuntimeError:
    from typer import Exit  # which a gateway that runs does without

    return Exit(code)


def _errors(group: BaseExceptionGroup[BaseException]) -> list[BaseException]:
    out: list[BaseException] = []
    for error in group.exceptions:
        out.extend(_errors(error) if isinstance(error, BaseExceptionGroup) else [error])
    return out


@contextmanager
def reported() -> Iterator[None]:
    """Turn Ropeway's errors, a closed pipe and Ctrl-C into sentences and exit codes."""
    try:
        yield
    except RopewayError as error:
        _report(error)
    except BaseExceptionGroup as group:
        errors = _errors(group)
        known = [error for error in errors if isinstance(error, RopewayError)]
        if len(known) != len(errors):
            raise
        _report(*known)
    except BrokenPipeError:
        # The reader of our output has gone; so that the interpreter's last flush does not complain, it gets a sink.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise _ended(0) from None
    except KeyboardInterrupt:
        raise _ended(130) from None


def _report(*errors: RopewayError) -> NoReturn:
    for error in errors:
        for line in str(error).splitlines():
            complain(f"ropeway: {line}")
    raise _ended(2 if any(isinstance(error, ConfigError) for error in errors) else 1)
