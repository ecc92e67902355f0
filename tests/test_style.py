"""Habits that no linter knows."""

from __future__ import annotations

import ast
from collections.abc import Callable
from functools import cache
from pathlib import Path

import pytest

from tests.conftest import SLOWEST

TESTS = Path(__file__).parent
SOURCES = TESTS.parent / "src" / "ropeway"


@cache
def _sources() -> dict[str, ast.Module]:
    """Return the modules of the package, each by its path in it."""
    return {str(path.relative_to(SOURCES)): ast.parse(path.read_text()) for path in sorted(SOURCES.rglob("*.py"))}


def _places(wanted: Callable[[ast.AST], bool]) -> list[tuple[str, ast.AST]]:
    """Return the nodes that are wanted, each with its ``module:function``."""
    found: list[tuple[str, ast.AST]] = []

    def look(node: ast.AST, module: str, inside: str) -> None:
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            inside = node.name
        if wanted(node):
            found.append((f"{module}:{inside}", node))
        for child in ast.iter_child_nodes(node):
            look(child, module, inside)

    for module, tree in _sources().items():
        look(tree, module, "")
    return found


@pytest.mark.parametrize("path", sorted(TESTS.rglob("test_*.py")), ids=lambda p: str(p.relative_to(TESTS)))
def test_every_test_states_its_behaviour(path: Path) -> None:
    """Each test has a docstring that is a sentence."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_"):
            text = ast.get_docstring(node)
            assert text, f"{path.name}: {node.name} has no docstring"
            assert text.rstrip().endswith("."), f"{path.name}: {node.name}: not a sentence"


def test_a_public_class_name_exists_once() -> None:
    """A public class name leads to one definition in the package."""
    places: dict[str, list[str]] = {}
    for module, tree in _sources().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(f"{module}:{node.lineno}")
    assert {name: where for name, where in places.items() if len(where) > 1} == {}


_RIDDLES = (
    "what who whose whom it its one true false they their he she there are is was were that this these those where when"
    " how why no none nothing nobody everybody everyone everything somebody someone something of in on at by for from"
    " to with without as if only more others another our"
)
RIDDLES = frozenset(_RIDDLES.split())
"""Openings that leave a docstring without a subject: the reader would have to guess who does what."""
_NOUNS = "the a an whether every all any both each messages events values bytes other called"
NOUNS = RIDDLES | frozenset(_NOUNS.split())
"""Openings of what ought to be an order: a function's docstring begins with its verb."""


def _opening(node: ast.AST, text: str) -> tuple[str, frozenset[str]]:
    """Return how a docstring begins, and which openings it must not have."""
    first = text.split()[0].rstrip(",.:;")
    if not isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
        return first, RIDDLES
    if any(ast.unparse(decorator).endswith(("property", ".setter")) for decorator in node.decorator_list):
        return first, RIDDLES
    return (first, NOUNS) if first[0].isupper() else ("the", NOUNS)


def test_docstrings_name_their_subject() -> None:
    """A function's docstring begins with its verb; that of a module, a class or a property with a verb or a noun."""
    found = []
    for module, tree in _sources().items():
        for node in ast.walk(tree):
            if isinstance(node, ast.Module | ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                text = ast.get_docstring(node)
                if not text:
                    continue
                first, refused = _opening(node, text)
                if first.lower() in refused:
                    found.append(f"{module}:{node.body[0].lineno}: {text.splitlines()[0]}")
    assert not found, "begin these with a verb, see CONTRIBUTING.md:\n" + "\n".join(found)


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
    "group/calls.py:first_true": AWAITED,
    "group/race.py:_begin": AWAITED,
    "hub/hub.py:_merged": AWAITED,
    "hub/calls.py:either": AWAITED,
    "networks/overlay/graph/calls.py:_call": AWAITED,
    "networks/overlay/graph/calls.py:answer_remote": AWAITED,
    "networks/ros1/xmlrpc.py:_accepted": ANSWERED,
    "iort.py:open": "the file stands alone; the task itself survives every failure, and tells it",
    "iort.py:_spawn": ANSWERED,
    "listener/connection.py:on_ws_connected": ANSWERED,
    "networks/overlay/rpc.py:_channel": AWAITED,
    "networks/foxglove/calls.py:call": ANSWERED,
    "networks/foxglove/parameters.py:_of_each": AWAITED,
    "networks/foxglove/server.py:welcome": ANSWERED,
    "networks/overlay/linked_sessions.py:ask": AWAITED,
    "networks/overlay/linked_sessions.py:linked": AWAITED,
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


def _begins_task(node: ast.AST) -> bool:
    name = node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""
    return name in ("create_task", "ensure_future")


def test_no_task_dies_unseen() -> None:
    """Background work is begun with the helpers of ``ropeway.tasks``, but where something else sees how it ends."""
    assert {place for place, _ in _places(_begins_task)} == set(ALLOWED_TASKS)


ALLOWED_BROAD = {
    "a callback or handler is the program's; its failure is logged and counted, or is the answer": {
        "api/callbacks.py:_run",
        "api/callbacks.py:put",
        "graph/actions/client.py:tell",
        "graph/actions/server.py:_accepts",
        "graph/actions/server.py:_agrees",
        "graph/actions/server.py:_carry_out",
        "graph/graph_base.py:guard",
        "graph/local_calls.py:_carry_out",
        "graph/local_calls.py:answer",
        "graph/parts.py:deliver",
        "graph/qos_adoption.py:deliver",
        "hub/topics.py:arrived",
        "iort.py:_pushed",
        "iort.py:_set_mode",
        "logs.py:emit",
        "networks/dds/fastdds/rpc.py:_serve_at",
        "networks/dds/service.py:answer",
        "networks/mqtt/connection.py:_attempt",
        "networks/zenoh/service.py:_serve",
        "networks/overlay/rpc.py:_answer",
        "networks/ros1/action_client.py:_take_feedback",
        "networks/ros1/action_server.py:_accepts",
        "networks/ros1/action_server.py:_cancel",
        "networks/ros1/action_server.py:_carry_out",
        "networks/ros1/service.py:_answer",
        "networks/ros2/service.py:_serve",
        "networks/rosbridge/client/actions.py:fed",
        "networks/rosbridge/client/parts.py:published",
        "networks/rosbridge/link/inbound.py:arrived",
        "networks/rosbridge/client/reconnect.py:set_state",
        "networks/rosbridge/client/servers.py:_agrees",
        "networks/rosbridge/client/servers.py:_carry_out",
        "networks/rosbridge/client/services.py:_answer",
        "networks/rosbridge/server/rosout.py:_publish",
    },
    "what a peer says, or a graph does, may fail one item in any way; the others go on": {
        "gateway/automatic.py:_try",
        "gateway/nodes.py:_look_out",
        "gateway/running_remote.py:close",
        "hub/hub.py:_look_out",
        "networks/dds/client.py:_lose",
        "networks/dds/fastdds/helper.py:_start",
        "networks/dds/fastdds/serdata_hook.py:from_ser",
        "networks/dds/fastdds/serdata_hook.py:to_ser_ref",
        "networks/dds/waitset.py:_catch_up",
        "graph/hand_over.py:_drain",
        "graph/inlet.py:deliver",
        "networks/dds/waitset.py:_finish",
        "networks/dds/waitset.py:_run",
        "networks/dds/writer_thread.py:_main",
        "networks/overlay/publisher_stream.py:_ask_key",
        "networks/overlay/feed.py:_open",
        "networks/overlay/membership.py:_ask",
        "networks/ros1/master_registration.py:_asked",
        "networks/ros2/senders.py:_main",
        "networks/ros2/senders.py:run",
        "networks/ros2/spinner.py:_handle",
        "networks/rosbridge/server/lingering.py:_withdraw_first",
        "networks/rosbridge/server/server.py:_tick_all",
        "networks/foxglove/server.py:_tick_all",
        "networks/zenoh/sender.py:_attempt",
        "store/store.py:_tell",
    },
    "whoever waits for the outcome gets the error": {
        "control/app.py:_response",
        "gateway/rest/app.py:__call__",
        "gateway/process/worker.py:_answer",
        "graph/actions/client.py:_follow",
        "graph/actions/client.py:_negotiate",
        "hub/actions.py:_wait",
        "listener/http_upgrade.py:_complete",
        "networks/dds/fastdds/node.py:_main",
        "networks/dds/waitset.py:_main",
        "networks/dds/waitset.py:run",
        "networks/ros1/service.py:_answer_all",
        "networks/ros1/xmlrpc.py:_answer",
        "networks/rosbridge/server/rosapi_calls.py:_ask",
        "networks/rosbridge/server/rosapi_calls.py:_begin",
        "store/thread.py:run_in",
    },
    "a library reads what others wrote, and raises errors of many kinds": {
        "gateway/tls.py:certificate_names",
        "networks/overlay/crypto/cbor.py:loads",
        "networks/overlay/crypto/certificate.py:__init__",
        "networks/overlay/crypto/material.py:understood",
        "networks/overlay/crypto/trust.py:update",
        "networks/ros1/xmlrpc.py:_loads",
    },
    "it supervises: what fails is noted, and begun again": {
        "audit/trail.py:_run",
        "bridge/upkeep.py:_run",
        "iort.py:_keep_connected",
        "networks/ros1/master_registration.py:_run",
        "networks/ros1/reader.py:_run",
        "tasks.py:_run",
        "tasks.py:keep_running",
        "tasks.py:start",
    },
}
"""Where everything may be caught that is not raised again, by the reason."""


def _catches_everything(node: ast.AST) -> bool:
    """Return whether a handler, or a ``suppress``, takes every error and does not raise it again."""
    if isinstance(node, ast.ExceptHandler):
        last = node.body[-1]
        kinds = node.type
        again = isinstance(last, ast.Raise) and last.exc is None
    elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("suppress"):
        kinds, again = ast.Tuple(node.args), False
    else:
        return False
    caught = kinds.elts if isinstance(kinds, ast.Tuple) else [kinds]
    return not again and any(
        isinstance(kind, ast.Name) and kind.id in ("Exception", "BaseException") for kind in caught
    )


def test_the_longest_files_are_there() -> None:
    """What is begun first is named as it is called."""
    assert [name for name in SLOWEST if not (TESTS / name).is_file()] == []


def test_no_bare_except() -> None:
    """Nothing in the package catches everything without naming it."""
    assert [place for place, node in _places(lambda n: isinstance(n, ast.ExceptHandler) and n.type is None)] == []


def test_everything_is_caught_at_boundaries_only() -> None:
    """Only the listed places catch every error, and each says why beside it."""
    found = _places(_catches_everything)
    listed = [place for places in ALLOWED_BROAD.values() for place in places]
    assert {place for place, _ in found} == set(listed)
    assert len(listed) == len(set(listed))
    for place, node in found:
        assert isinstance(node, ast.ExceptHandler | ast.Call)
        line = (SOURCES / place.partition(":")[0]).read_text().splitlines()[node.lineno - 1]
        assert "  # " in line, f"{place} does not say why it catches everything"


LONGEST_LINES = 450
LONGER = {
    "iort.py": 2200,  # one file by design: nodes copy it
    "limits.py": 650,  # one table by design: whoever looks for a limit finds it here
}
"""The modules that are longer than others may be, and how long at most."""


def test_modules_are_short() -> None:
    """No module has more than 450 lines, but for those that are listed, which do not grow."""
    lines = {module: len((SOURCES / module).read_text().splitlines()) for module in _sources()}
    too_long = {module: n for module, n in lines.items() if n > LONGER.get(module, LONGEST_LINES)}
    assert too_long == {}, "split these by purpose"
    assert [module for module in LONGER if lines[module] <= LONGEST_LINES] == [], "take these off the list"
