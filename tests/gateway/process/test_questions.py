"""ropeway.gateway.process.questions: questions by name, for another process."""

from __future__ import annotations

import sys
import threading
from pathlib import Path

import pytest

from ropeway.gateway.process.changes import prepare
from ropeway.gateway.process.questions import find_question, question_name


async def test_a_question_is_found_by_its_name() -> None:
    """A question is found again by the name that crosses the pipe to a worker."""
    assert await find_question(question_name(prepare)) is prepare


async def test_a_question_is_loaded_in_a_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The module of a question that nobody has asked yet is imported in a thread: messages cross meanwhile."""
    monkeypatch.syspath_prepend(tmp_path)
    (tmp_path / "late_questions.py").write_text(
        "import threading\nthread = threading.current_thread()\nasync def ask(gateway, params): return 1\n"
    )
    question = await find_question("late_questions:ask")
    assert await question(None, {}) == 1
    assert sys.modules.pop("late_questions").thread is not threading.main_thread()
