"""ropeway.cli.lazy: verbs that are imported when they are used."""

from __future__ import annotations

import pytest

from tests.cli.conftest import Ropeway


@pytest.mark.parametrize(
    ("typed", "meant"), [(["topc", "list"], "topic"), (["topic", "ech"], "echo"), (["lifecicle"], "lifecycle")]
)
def test_a_mistyped_verb(in_process: Ropeway, typed: list[str], meant: str) -> None:
    """A verb that is not there ends with the one that was meant."""
    ended = in_process(*typed)
    assert ended.returncode == 2
    assert f"Did you mean {meant}?" in ended.stderr.replace("\n", " ")


def test_nothing_near(in_process: Ropeway) -> None:
    """Nothing is suggested where nothing is near."""
    ended = in_process("topic", "xyzzy")
    assert ended.returncode == 2
    assert "mean" not in ended.stderr
