"""What the documents show, works."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml

from ropeway.gateway import config
from ropeway.wire.codec import ENCODINGS

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", ROOT / "examples" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(json|yaml)\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!http)([^)#]+)")


def blocks() -> list[tuple[str, str, str]]:
    return [(p.name, kind, text) for p in DOCUMENTS for kind, text in BLOCK.findall(p.read_text())]


@pytest.mark.parametrize(("name", "kind", "text"), blocks())
def test_configurations(name: str, kind: str, text: str, tmp_path: Path) -> None:
    """Every configuration in the documents is accepted, where the files are that it names."""
    (tmp_path / "robot1.ropeway").touch()
    config.parse(json.loads(text) if kind == "json" else yaml.safe_load(text), name, directory=tmp_path)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: p.name)
def test_links(document: Path) -> None:
    """Every link to a file of the project leads somewhere."""
    for target in LINK.findall(document.read_text()):
        assert (document.parent / target).exists(), target


def test_encodings_are_documented() -> None:
    """The configuration's document names every encoding."""
    text = (ROOT / "docs" / "configuration.md").read_text()
    for encoding in (*ENCODINGS, "auto"):
        assert f"`{encoding}`" in text
