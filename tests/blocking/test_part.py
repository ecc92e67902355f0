"""The end of what threads use."""

from __future__ import annotations

import threading

import pytest

from ropeway import GraphUnavailable, blocking


def test_closing_more_than_once(network: str) -> None:
    """Closing again does no harm, in any order and from several threads at once; the thread of the loop then ends."""
    graph = blocking.open(network)
    other = blocking.open(network)
    publisher = graph.publisher("/a", "std_msgs/String")
    threads = [threading.Thread(target=graph.close) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert other.topics() == {}
    publisher.close()
    other.close()
    publisher.close()
    graph.close()
    with pytest.raises(GraphUnavailable, match="everything that was opened in this process is closed"):
        graph.topics()
