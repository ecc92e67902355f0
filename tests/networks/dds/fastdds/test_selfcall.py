"""The hook and its self-test, in processes of their own: what they change in a library, they change for good."""

from __future__ import annotations

import subprocess
import sys
import textwrap

import pytest

from tests.support.until import PATIENCE_S

PRELUDE = """
import ctypes, sys
from ropeway.networks.dds import raw
from ropeway.networks.dds.fastdds import early_reader, serdata_hook as hook, selfcall
raw.load("test")
"""


def run(code: str) -> str:
    """What Python code prints."""
    done = subprocess.run(
        [sys.executable, "-c", PRELUDE + textwrap.dedent(code)], capture_output=True, text=True, timeout=PATIENCE_S
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_passes() -> None:
    """The self-test finds nothing wrong, twice in one process, and leaves nothing behind."""
    assert run("print(selfcall.wrong() or selfcall.wrong() or (len(hook.notes), dict(hook.faults)))") == "(0, {})"


@pytest.mark.parametrize(
    ("change", "texts"),
    [
        ("hook._SERTYPE_NAME = 40", "the name of a type is not where it should be"),
        (
            "hook._Version.seq = property(lambda version: -64)",
            "a writer's number does not count|not where it should be",
        ),
        ("hook._FROM_TYPE['keyhash'] = hook._FROM_TYPE['readers'] + 16", "not where it should be|not tell who waits"),
        ("hook._WRITER_GUID = 12", "a writer or reader is not found behind its handle"),
        ("early_reader._PLACES = ((-16, b''),)", "the flags of a reader are not where they should be"),
        ("early_reader._BOTH = 5", "the flags of a reader have another order"),
        ("hook._GET_SIZE = 0", "the table of functions is another one"),
        ("hook._Version.no_key = property(lambda version: b'another')", "the table of functions has another order"),
        ("hook._MESSAGE_BYTES = 40", "no RTPS"),
        ("hook._WITH_LONG_STATUS = 0", "message has moved"),
        ("hook._MAGIC = bytes(16); hook._KEYHASH_PARAMETER = bytes(4)", "message has moved"),
    ],
)
def test_finds(change: str, texts: str) -> None:
    """A library that is laid out in another way is found out, and named as far as what lies there allows."""
    code = f"""
    {change}
    print(selfcall.wrong(), dict(hook.faults))
    """
    said = run(code)
    assert any(text in said for text in texts.split("|")), said


def test_no_loopback() -> None:
    """Where no network can be used, the self-test says so."""
    code = """
    xml = selfcall._xml
    selfcall._xml = lambda tag: xml(tag).replace('name="lo"', 'name="none0"')
    print(selfcall.wrong())
    """
    assert "cannot start" in run(code)


def test_errors_stay_inside() -> None:
    """What fails on behalf of the library is counted, and costs no sample."""
    code = """
    hook._note_origin = hook._write_parameter = lambda *_: 1 / 0
    selfcall.wrong()
    print(sorted(hook.faults))
    """
    assert run(code).endswith("['origin: ZeroDivisionError', 'parameter: ZeroDivisionError']")


def test_bad_memory() -> None:
    """Memory that is not there is read as nothing, without a fault."""
    assert run("print(hook._read(8, 16), hook._read(-1, 4), hook._read(2**63 + 5, 4))") == "b'' b'' b''"
