"""Habits that no linter knows."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

TESTS = Path(__file__).parent
SOURCES = TESTS.parent / "src" / "ropeway"


@pytest.mark.parametrize("path", sorted(TESTS.rglob("test_*.py")), ids=lambda p: str(p.relative_to(TESTS)))
def test_every_test_states_its_behaviour(path: Path) -> None:
    """Each test has a docstring that is a sentence."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"):
            text = ast.get_docstring(node)
            assert text, f"{path.name}: {node.name} has no docstring"
            assert text.rstrip().endswith("."), f"{path.name}: {node.name}: not a sentence"


def test_no_bare_except() -> None:
    """Nothing in the package catches everything without naming it."""
    for path in SOURCES.rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ExceptHandler):
                assert node.type is not None, f"{path}:{node.lineno}"


def test_a_public_class_name_exists_once() -> None:
    """A public class name leads to one definition in the package."""
    places: dict[str, list[str]] = {}
    for path in sorted(SOURCES.rglob("*.py")):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(f"{path.relative_to(SOURCES)}:{node.lineno}")
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


AWAITED = "whoever begins it waits for it there, and sees how it ends"
ANSWERED = "when it is done, a callback logs its failure and answers whoever waits"
ALLOWED_TASKS = {
    "cli/action/send_goal.py:send_goal": AWAITED,
    "cli/demo/__init__.py:_cross": AWAITED,
    "cli/demo_iort/drive.py:drive": AWAITED,
    "cli/param/list_.py:list_all": "a task group",
    "cli/patience.py:patiently": AWAITED,
    "cli/router.py:_serve": AWAITED,
    "cli/serving.py:serve": AWAITED,
    "cli/serving.py:_run": AWAITED,
    "cli/session.py:discover": AWAITED,
    "gateway/process/worker.py:_run": AWAITED,
    "graph/actions/client.py:send_goal": AWAITED,
    "group/calls.py:begin": AWAITED,
    "group/calls.py:first_true": AWAITED,
    "hub/hub.py:_merged": AWAITED,
    "hub/calls.py:either": AWAITED,
    "networks/overlay/graph/calls.py:_call": AWAITED,
    "networks/overlay/graph/calls.py:answer_remote": AWAITED,
    "networks/rosbridge/client/actions.py:send_goal": AWAITED,
    "networks/ros1/xmlrpc.py:_accepted": ANSWERED,
    "iort.py:open": "the file stands alone; the task itself survives every failure, and tells it",
    "iort.py:_spawn": ANSWERED,
    "listener/connection.py:on_ws_connected": ANSWERED,
    "networks/overlay/rpc.py:_channel": AWAITED,
    "networks/rosbridge/server/action_offers.py:run": AWAITED,
    "networks/rosbridge/server/action_ops.py:__init__": ANSWERED,
    "networks/rosbridge/rosapi/params.py:names": AWAITED,
    "networks/rosbridge/server/server.py:_connected": ANSWERED,
    "networks/rosbridge/server/server.py:_close_sessions": AWAITED,
    "networks/rosbridge/server/service_ops.py:call": ANSWERED,
    "aio310.py:create_task": "its group waits for it",
    "aio310.py:run": "it is waited for",
    "tasks.py:start": "it is the helper",
    "tasks.py:background": "it is the helper",
}
"""Where a task may be begun without the helpers of ``ropeway.tasks``, and why none is lost there."""


def _bare_tasks(path: Path) -> set[str]:
    """Return the functions of a module that begin tasks themselves, each with the module's path."""
    found: set[str] = set()

    def look(node: ast.AST, inside: str) -> None:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            inside = node.name
        if isinstance(node, ast.Attribute | ast.Name):
            name = node.attr if isinstance(node, ast.Attribute) else node.id
            if name in ("create_task", "ensure_future"):
                found.add(f"{path.relative_to(SOURCES)}:{inside}")
        for child in ast.iter_child_nodes(node):
            look(child, inside)

    look(ast.parse(path.read_text()), "")
    return found


def test_no_task_dies_unseen() -> None:
    """Background work is begun with the helpers of ``ropeway.tasks``, but where something else sees how it ends."""
    found = set().union(*(_bare_tasks(path) for path in SOURCES.rglob("*.py")))
    assert found == set(ALLOWED_TASKS)
