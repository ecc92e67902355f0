"""What the documents show, works."""

from __future__ import annotations

import ast
import asyncio
import json
import re
from pathlib import Path

import pytest
import yaml

import ropeway
from ropeway.gateway.config import config
from ropeway.gateway.config.fleet import is_fleet, read_fleet
from ropeway.networks.rosbridge.protocol.codec import ENCODINGS

ROOT = Path(__file__).parents[2]
DOCUMENTS = [ROOT / "README.md", ROOT / "examples" / "README.md", *sorted((ROOT / "docs").glob("*.md"))]
BLOCK = re.compile(r"^```(json|yaml)\n(.*?)^```", re.MULTILINE | re.DOTALL)
PYTHON = re.compile(r"^```python\n(.*?)^```", re.MULTILINE | re.DOTALL)
LINK = re.compile(r"\]\((?!http)([^)#]+)")


def blocks() -> list[tuple[str, str, str]]:
    return [(p.name, kind, text) for p in DOCUMENTS for kind, text in BLOCK.findall(p.read_text())]


@pytest.mark.parametrize(("name", "kind", "text"), blocks())
def test_configurations(name: str, kind: str, text: str, tmp_path: Path) -> None:
    """Every configuration in the documents is accepted, where the files are that it names."""
    (tmp_path / "robot1.ropeway").touch()
    document = json.loads(text) if kind == "json" else yaml.safe_load(text)
    if is_fleet(document):
        assert read_fleet(document, name, directory=tmp_path).findings() == []
    else:
        config.parse(document, name, directory=tmp_path)


@pytest.mark.parametrize("document", DOCUMENTS, ids=lambda p: p.name)
def test_programs(document: Path) -> None:
    """Every program in the documents can be compiled, and uses names that the package exports."""
    for text in PYTHON.findall(document.read_text()):
        compile(text, document.name, "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT)
        for name in re.findall(r"\bropeway\.(\w+)", text):
            assert name == "iort" or name in ropeway.__all__, name


async def test_services_and_actions_of_the_library() -> None:
    """The program that shows services and actions runs as it is printed."""
    page = (ROOT / "docs" / "library.md").read_text()
    (text,) = [text for text in PYTHON.findall(page) if "serve_action" in text]
    text = text.replace("asyncio.sleep(1)", "asyncio.sleep(0)")
    printed: list[str] = []
    async with ropeway.open("memory:docs") as graph:
        names = {
            "graph": graph,
            "asyncio": asyncio,
            "print": lambda *values: printed.append(" ".join(map(str, values))),
        }
        await eval(compile(text, "library.md", "exec", ast.PyCF_ALLOW_TOP_LEVEL_AWAIT), names)
    assert printed[0] == "3"
    assert printed[-1].startswith("SUCCEEDED <example_interfaces/action/Fibonacci_Result")


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


def test_modules_of_the_architecture() -> None:
    """Every module and folder that the page on the architecture names is there."""
    text = (ROOT / "docs" / "architecture.md").read_text()
    sources = ROOT / "src" / "ropeway"
    named = {path.rstrip("/") for path in re.findall(r"`([a-z][\w]*(?:/[\w.]+)+|[\w]+\.py)`", text)}
    missing = [path for path in named if not (sources / path).exists() and not (ROOT / path).exists()]
    assert named, "no module is named"
    assert not [path for path in missing if path != "networks/NAME"], missing
