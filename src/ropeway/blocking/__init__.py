"""The library for scripts, notebooks and threads: the same as ``ropeway`` itself, without asyncio.

::

    from ropeway import blocking

    with blocking.open("dds:0") as graph, graph.subscribe("/chatter") as messages:
        for message in messages:
            print(message["data"])

All objects may be used from any thread. One event loop in a thread of its own does the work, from the first ``open`` to
the last ``close``; functions that a program gives run in threads, so they may wait. Whatever waits has a time limit,
``timeout_s``, and Ctrl-C ends the wait.
"""

from ropeway.blocking.calls import (
    BlockingActionClient,
    BlockingActionServer,
    BlockingClient,
    BlockingExecutingGoal,
    BlockingGoal,
    BlockingService,
)
from ropeway.blocking.gateways import BlockingBridge, BlockingGateway, open_bridge, open_gateway
from ropeway.blocking.graph import BlockingGraph, open
from ropeway.blocking.topics import BlockingPublisher, BlockingSubscription

__all__ = [
    "BlockingActionClient",
    "BlockingActionServer",
    "BlockingBridge",
    "BlockingClient",
    "BlockingExecutingGoal",
    "BlockingGateway",
    "BlockingGoal",
    "BlockingGraph",
    "BlockingPublisher",
    "BlockingService",
    "BlockingSubscription",
    "open",
    "open_bridge",
    "open_gateway",
]


def __dir__() -> list[str]:
    return sorted(__all__)
