"""Fixtures of all tests, and the event loops that they run on."""

from __future__ import annotations

import asyncio
import os
import signal
import tempfile
from collections.abc import AsyncIterator, Callable, Generator, Iterator
from contextlib import AsyncExitStack
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from hypothesis import HealthCheck, settings

from tests.support.clock import JumpingLoop
from tests.support.isolation import isolated_dds

if TYPE_CHECKING:
    from xdist.remote import Producer

    from tests.support.scheduling import FileScheduling

# How long an example may take, or take to be made, is not for the clock of a busy machine to say.
settings.register_profile("ropeway", deadline=None, suppress_health_check=[HealthCheck.too_slow])
settings.load_profile("ropeway")


SLOWEST = (
    "soak/test_memory_nodes.py",
    "soak/test_memory_clients.py",
    "soak/test_memory_overlay.py",
    "soak/test_memory_unread.py",
    "soak/test_churn.py",
    "faults/test_links.py",
    "deploy/test_debian.py",
    "deploy/test_container.py",
    "gateway/test_side_by_side.py",
    "soak/test_memory_strangers.py",
    "soak/test_memory_dds.py",
    "soak/test_soak.py",
    "faults/test_calls.py",
    "faults/test_lan.py",
    "fuzz/test_targets.py",
    "cli/test_overlay.py",
    "networks/overlay/graph/test_graph.py",
    "gateway/process/test_supervisor.py",
    "test_examples.py",
    "networks/rosbridge/server/test_roslibpy.py",
    "contract/test_services.py",
    "contract/test_actions.py",
    "networks/ros1/test_rospy.py",
    "iort/test_local_server.py",
    "cli/test_run.py",
    "networks/ros1/test_roscpp.py",
    "cli/test_dds_calls.py",
    "listener/test_connection.py",
    "contract/test_topics.py",
    "networks/dds/fastdds/test_selfcall.py",
    "networks/overlay/test_attacks.py",
    "networks/dds/fastdds/test_rpc.py",
    "networks/overlay/test_fleet.py",
    "types/test_weight.py",
    "networks/rosbridge/client/test_services.py",
    "iort/test_node.py",
    "cli/test_server.py",
    "delivery/pacing/test_model.py",
    "networks/rosbridge/server/test_turns.py",
    "networks/rosbridge/server/test_browser.py",
    "cli/test_dds.py",
    "types/test_bundled.py",
    "cli/test_store.py",
    "gateway/test_calls.py",
    "networks/dds/fastdds/test_helper.py",
)
"""The files that take longest, which are begun first, so that no process is left with one at the end.

Those of slow tests come before the others; ``--durations=0`` tells how long each takes.
"""


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Begin with the longest files."""
    ranks = {Path(__file__).parent / name: rank for rank, name in enumerate(SLOWEST)}
    items.sort(key=lambda item: ranks.get(item.path, len(ranks)))


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_auto_num_workers() -> int:
    """Run two processes on each core, as tests wait for others about as long as they compute."""
    return 2 * (os.cpu_count() or 1)


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Producer) -> FileScheduling | None:
    """Finish a run also where one of its processes crashes."""
    if config.getvalue("dist") != "loadfile":
        return None
    from tests.support.scheduling import FileScheduling

    return FileScheduling(config, log)


def pytest_asyncio_loop_factories(item: pytest.Item) -> dict[str, Callable[[], asyncio.AbstractEventLoop]]:
    """Tests that are marked ``jumping`` run on a loop that does not wait, all others on asyncio's own."""
    return {"asyncio": JumpingLoop if item.get_closest_marker("jumping") else asyncio.new_event_loop}


def pytest_configure() -> None:
    """Let Ctrl-C reach the processes that tests start, also where a shell has put the test run into the background."""
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:  # which processes inherit
        signal.signal(signal.SIGINT, signal.default_int_handler)


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport() -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Write half characters out, which tests log and no process of pytest could hand to another."""
    report = yield
    report.sections = [(title, text.encode(errors="backslashreplace").decode()) for title, text in report.sections]
    return report


@pytest.fixture(scope="session", autouse=True)
def dds_isolation() -> Iterator[None]:
    """Participants of this process, and of those it starts, discover each other and no other test run."""
    with isolated_dds():
        yield


@pytest.fixture(scope="session", autouse=True)
def own_directories() -> Iterator[None]:
    """Gateways of this test run, and of the processes that it starts, leave nothing in the user's directories."""
    with tempfile.TemporaryDirectory(prefix="rw-") as directory, pytest.MonkeyPatch.context() as patch:
        for name in ("XDG_RUNTIME_DIR", "XDG_STATE_HOME"):
            place = Path(directory) / name.split("_")[1].lower()
            place.mkdir(mode=0o700)
            patch.setenv(name, str(place))
        yield


@pytest.fixture
async def stack() -> AsyncIterator[AsyncExitStack]:
    """What the test has to end, in the order it is told."""
    async with AsyncExitStack() as made:
        yield made
