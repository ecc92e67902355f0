"""ropeway.control.app: answers of the control API."""

from __future__ import annotations

import subprocess
import sys

_PROGRAM = """
import sys
from ropeway.control.app import _answer
from ropeway.control.resource import Answer

class Step:
    def to_json(self):
        return {"action": "start"}

assert _answer(Answer([Step()])).body == b'[{"action":"start"}]'
assert "numpy" not in sys.modules
import numpy
assert _answer(Answer({"array": numpy.array([1, 2])})).body == b'{"array":[1,2]}'
"""


def test_an_answer_loads_no_numpy() -> None:
    """Objects and arrays become JSON, and numpy is not loaded to look whether an object is one of its arrays."""
    done = subprocess.run([sys.executable, "-c", _PROGRAM], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
