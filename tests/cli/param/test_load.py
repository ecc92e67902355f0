"""ropeway param load: what a file of parameters has for a node."""

from __future__ import annotations

from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ropeway.cli.param.load import parameters_for
from tests.cli.conftest import Ropeway

FILE = {
    "/**": {"ros__parameters": {"use_sim_time": True, "rate": 1}},
    "/robot1": {"camera": {"ros__parameters": {"rate": 30, "image": {"width": 640}}}},
    "/robot2/camera": {"ros__parameters": {"rate": 15}},
    "/*/camera": {"ros__parameters": {"any": "yes"}},
}


def test_who_is_meant() -> None:
    """Nodes are named in full, nested in namespaces, or by patterns; later entries win."""
    assert parameters_for(FILE, "/robot1/camera") == {
        "use_sim_time": True, "rate": 30, "image.width": 640, "any": "yes",
    }  # fmt: skip
    assert parameters_for(FILE, "/robot2/camera")["rate"] == 15
    assert parameters_for(FILE, "/talker") == {"use_sim_time": True, "rate": 1}
    assert parameters_for(FILE, "/robot1/camera", wildcards=False) == {"rate": 30, "image.width": 640}
    assert parameters_for(FILE, "/talker", wildcards=False) == {}


@pytest.mark.parametrize("document", [None, [1], "x", {"/n": 1}, {"/n": {"ros__parameters": 3}}, {"rate": 1}])
def test_no_file_of_parameters(document: object) -> None:
    """What is no file of parameters is refused with what is expected."""
    with pytest.raises(ValueError, match="expected"):
        parameters_for(document, "/n")


@given(
    st.recursive(
        st.none() | st.integers() | st.text(), lambda below: st.lists(below) | st.dictionaries(st.text(), below)
    )
)
def test_any_document(document: object) -> None:
    """Whatever a file holds is read or refused."""
    try:
        assert isinstance(parameters_for(document, "/a/b"), dict)
    except ValueError as error:
        assert "expected" in str(error)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        (None, "No such file"),
        ("a: [", "not YAML"),
        ("[1]", "not a file of parameters"),
        ("/other: {ros__parameters: {a: 1}}", "nothing for /n"),
        ("/n: {ros__parameters: {a: [1, x]}}", "cannot be a parameter"),
    ],
)
def test_files_that_cannot_be_loaded(in_process: Ropeway, tmp_path: Path, text: str | None, told: str) -> None:
    """A file that cannot be loaded ends with why, before any node is asked."""
    if text is not None:
        (tmp_path / "n.yaml").write_text(text)
    ended = in_process("param", "load", "/n", str(tmp_path / "n.yaml"), "-g", "memory:param-load", "--timeout", "0.1")
    assert ended.returncode == 2
    assert told in ended.stderr
