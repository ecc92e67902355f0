"""Names and processes for the tests of the dds graph."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

DDS_STRING = "std_msgs::msg::dds_::String_"

_PRELUDE = """
    import asyncio, sys, time
    from ropeway.networks.dds import DdsGraph
    from ropeway.qos import *
    from tests.support.inbox import Inbox
    from tests.support.messages import STRING, sample, text
    from tests.support.until import until
"""


@contextmanager
def process(code: str, *arguments: object) -> Iterator[subprocess.Popen[str]]:
    """Python code in a process of its own, with what these tests share imported; ``sys.argv[1:]`` are the arguments."""
    code = textwrap.dedent(_PRELUDE) + textwrap.dedent(code)
    with subprocess.Popen(
        [sys.executable, "-c", code, *map(str, arguments)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
        cwd=Path(__file__).parents[3],
    ) as child:
        try:
            yield child
        finally:
            child.kill()


def stop(child: subprocess.Popen[str]) -> None:
    """Stop a process, and wait until all of its threads stand: until then it may still answer."""
    child.send_signal(signal.SIGSTOP)
    os.waitid(os.P_PID, child.pid, os.WSTOPPED)
