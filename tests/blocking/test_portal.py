"""The way from threads into an event loop."""

from __future__ import annotations

import asyncio
import gc
import os
import signal
import subprocess
import sys
import threading

import pytest

from ropeway import GraphUnavailable, WaitTimeout, blocking
from ropeway.blocking.portal import Portal


async def waiting() -> None:
    await asyncio.Event().wait()


async def one() -> int:
    return 1


def test_runs_for_its_users() -> None:
    """The thread runs from the first user to the last, and again for the next."""
    portal = Portal()
    with pytest.raises(GraphUnavailable):
        portal.run(one)
    for _ in range(2):
        portal.enter()
        portal.enter()
        portal.leave()
        assert portal.run(one) == 1
        portal.leave()
        with pytest.raises(GraphUnavailable):
            portal.run(one)


def test_limit() -> None:
    """What takes too long is cancelled, and the caller is told."""
    portal = Portal()
    portal.enter()
    with pytest.raises(WaitTimeout):
        portal.run(waiting, 0.01)
    portal.leave()


def test_end_ends_waits() -> None:
    """Whoever waits when the last user leaves is told that everything is closed."""
    portal = Portal()
    portal.enter()
    began = threading.Event()
    told: list[Exception] = []

    async def begun() -> None:
        began.set()
        await waiting()

    def wait() -> None:
        try:
            portal.run(begun, None)
        except GraphUnavailable as error:
            told.append(error)

    thread = threading.Thread(target=wait)
    thread.start()
    assert began.wait(10)
    portal.leave()
    thread.join(10)
    assert len(told) == 1


def test_own_thread() -> None:
    """The thread of the loop cannot wait for itself, and says so."""
    portal = Portal()
    portal.enter()

    async def within() -> None:
        portal.run(one)

    with pytest.raises(RuntimeError, match="call it from another"):
        portal.run(within)
    portal.leave()


def test_interrupt() -> None:
    """Ctrl-C ends a wait, and what was waited for."""
    portal = Portal()
    portal.enter()
    ended = threading.Event()

    async def wait() -> None:
        try:
            asyncio.get_running_loop().call_soon(os.kill, os.getpid(), signal.SIGINT)
            await waiting()
        finally:
            ended.set()

    with pytest.raises(KeyboardInterrupt):
        portal.run(wait, None)
    assert ended.wait(10)
    portal.leave()


def test_failure_to_open() -> None:
    """A graph that cannot be opened leaves no thread behind."""
    with pytest.raises(GraphUnavailable):
        blocking.open("dds:999")
    with pytest.raises(GraphUnavailable):
        blocking.open_bridge("memory:a", "dds:999")


def test_end_of_the_program() -> None:
    """A program that forgets to close its graph ends all the same, and without a complaint."""
    program = (
        "from ropeway import blocking\n"
        "graph = blocking.open('dds:58?interface=lo')\n"
        "publisher = graph.publisher('/a', 'std_msgs/String')\n"
        "publisher.publish({'data': 'hi'})\n"
        "print('end')\n"
    )
    done = subprocess.run([sys.executable, "-W", "error", "-c", program], capture_output=True, text=True, timeout=50)
    assert (done.returncode, done.stdout, done.stderr) == (0, "end\n", "")


def test_nobody_holds_it() -> None:
    """A graph whose last reference is gone stays open until the end of the program."""
    subscription = blocking.open("memory:held").subscribe("/a", "std_msgs/String")
    gc.collect()
    blocking.open("memory:held").publisher("/a", "std_msgs/String").publish({"data": "a"})
    assert subscription.receive()["data"] == "a"


@pytest.mark.filterwarnings(
    "ignore::DeprecationWarning"
)  # Python 3.12 warns of forks beside threads, which is the point
def test_fork() -> None:
    """In a process that was forked the graphs of its parent are closed, and it may open its own."""
    with blocking.open("memory:fork") as graph:
        child = os.fork()
        if child == 0:
            try:
                graph.topics()
            except GraphUnavailable:
                with blocking.open("memory:fork2") as own:
                    os._exit(0 if own.topics() == {} else 2)
            os._exit(1)
        assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
        assert graph.topics() == {}
