"""The public surface of the package: what it exports, and nothing else."""

from __future__ import annotations

import ast
import re
import subprocess
import sys
import types
from pathlib import Path

import pytest

import ropeway
import ropeway.blocking

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "library.md").read_text()


def python(program: str) -> str:
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    return done.stdout.strip()


@pytest.mark.parametrize("module", [ropeway, ropeway.blocking], ids=lambda module: module.__name__)
def test_nothing_else_is_public(module: types.ModuleType) -> None:
    """Every public name of the package is exported, in alphabetical order, and everything exported is there."""
    for name in module.__all__:
        assert getattr(module, name) is not None
    public = {
        name
        for name, value in vars(module).items()
        if not name.startswith("_") and not (isinstance(value, types.ModuleType) and name not in module.__all__)
    }
    assert public | {"__version__"} == set(module.__all__) | {"__version__"}
    assert list(module.__all__) == sorted(module.__all__)
    assert dir(module) == sorted(module.__all__)


@pytest.mark.parametrize("module", [ropeway, ropeway.blocking], ids=lambda module: module.__name__)
def test_everything_is_documented(module: types.ModuleType) -> None:
    """Every exported name has a docstring and stands in the page about the library."""
    for name in set(module.__all__) - {"__version__"}:
        value = getattr(module, name)
        assert value.__doc__, name
        assert re.search(rf"\b{name}\b", PAGE), f"docs/library.md does not tell of {name}"
        for method, function in vars(value).items() if isinstance(value, type) else ():
            if not method.startswith("_") and isinstance(function, (types.FunctionType, property)):
                assert function.__doc__, f"{name}.{method}"


def test_what_type_checkers_see() -> None:
    """Type checkers see the same names, from the same modules, as programs get."""
    tree = ast.parse(Path(ropeway.__file__).read_text())
    block = next(node for node in tree.body if isinstance(node, ast.If))
    seen = {
        alias.name: node.module
        for node in block.body
        if isinstance(node, ast.ImportFrom) and node.module not in ("typing", "ropeway")
        for alias in node.names
    }
    assert set(seen) == set(ropeway.__all__) - {"__version__", "blocking"}
    for name, home in seen.items():
        assert home is not None
        assert getattr(sys.modules[home], name) is getattr(ropeway, name)


def test_import_costs_nothing() -> None:
    """Importing the package imports no other module; the first use of a name imports what it needs."""
    program = "import sys; before = set(sys.modules); import ropeway; print(sorted(set(sys.modules) - before))"
    assert python(program) == "['ropeway']"
    program = "import sys, ropeway; ropeway.QoS; print('ropeway.qos' in sys.modules, 'asyncio' in sys.modules)"
    assert python(program) == "True False"


def test_unknown_name() -> None:
    """A name that is not exported is an AttributeError, as of any module."""
    with pytest.raises(AttributeError, match="module 'ropeway' has no attribute 'nothing'"):
        ropeway.nothing  # type: ignore[attr-defined]  # noqa: B018
    assert not hasattr(ropeway, "nothing")


def test_typed() -> None:
    """The package tells type checkers that it has types."""
    assert Path(ropeway.__file__).with_name("py.typed").exists()
