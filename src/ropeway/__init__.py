"""Ropeway joins robots and clouds that live on different networks.

Everything that has topics, services and actions is a ``Graph``; a bridge joins one name on two graphs. As a library::

    import asyncio
    import ropeway

    async def main():
        async with ropeway.open("dds:0") as graph, graph.subscribe("/chatter") as messages:
            async for message in messages:
                print(message["data"])

    asyncio.run(main())

``ropeway.open``, ``open_bridge`` and ``open_gateway`` are for asyncio, ``ropeway.blocking`` has the same for scripts
and notebooks. Names are imported when they are first used, so that ``import ropeway`` costs nothing.
"""

TYPE_CHECKING = False  # as type checkers see it, without importing typing
if TYPE_CHECKING:
    from ropeway import blocking
    from ropeway.api.actions import AsyncActionClient, AsyncActionServer, AsyncGoal, ExecutingGoal, GoalResult
    from ropeway.api.bridge import AsyncBridge, open_bridge
    from ropeway.api.gateway import AsyncGateway, open_gateway
    from ropeway.api.graph import AsyncGraph, open
    from ropeway.api.message import TypedMessage
    from ropeway.api.services import AsyncClient, AsyncService
    from ropeway.api.topics import AsyncPublisher, AsyncSubscription
    from ropeway.errors import (
        CallError,
        CallFailed,
        CallTimeout,
        ConfigError,
        ConnectFailed,
        DecodeError,
        GoalRejected,
        GraphError,
        GraphUnavailable,
        InvalidDefinition,
        InvalidName,
        NotServed,
        ProviderLost,
        Refused,
        RopewayError,
        TypeConflict,
        TypesError,
        UnknownType,
        ValueMismatch,
        WaitTimeout,
    )
    from ropeway.graph.base import Delivery
    from ropeway.graph.calls import GoalStatus
    from ropeway.qos import QoS

__all__ = [
    "AsyncActionClient",
    "AsyncActionServer",
    "AsyncBridge",
    "AsyncClient",
    "AsyncGateway",
    "AsyncGoal",
    "AsyncGraph",
    "AsyncPublisher",
    "AsyncService",
    "AsyncSubscription",
    "CallError",
    "CallFailed",
    "CallTimeout",
    "ConfigError",
    "ConnectFailed",
    "DecodeError",
    "Delivery",
    "ExecutingGoal",
    "GoalRejected",
    "GoalResult",
    "GoalStatus",
    "GraphError",
    "GraphUnavailable",
    "InvalidDefinition",
    "InvalidName",
    "NotServed",
    "ProviderLost",
    "QoS",
    "Refused",
    "RopewayError",
    "TypeConflict",
    "TypedMessage",
    "TypesError",
    "UnknownType",
    "ValueMismatch",
    "WaitTimeout",
    "__version__",
    "blocking",
    "open",
    "open_bridge",
    "open_gateway",
]

__version__ = "0.1.0"

_HOMES = {
    "ropeway.api.actions": ("AsyncActionClient", "AsyncActionServer", "AsyncGoal", "ExecutingGoal", "GoalResult"),
    "ropeway.api.bridge": ("AsyncBridge", "open_bridge"),
    "ropeway.api.gateway": ("AsyncGateway", "open_gateway"),
    "ropeway.api.graph": ("AsyncGraph", "open"),
    "ropeway.api.message": ("TypedMessage",),
    "ropeway.api.services": ("AsyncClient", "AsyncService"),
    "ropeway.api.topics": ("AsyncPublisher", "AsyncSubscription"),
    "ropeway.graph.base": ("Delivery",),
    "ropeway.graph.calls": ("GoalStatus",),
    "ropeway.qos": ("QoS",),
}
"""Where the exported names are defined; the others are errors, all of one module."""


if not TYPE_CHECKING:  # to type checkers a name that is not above is a mistake

    def __getattr__(name: str) -> object:
        """Import an exported name when it is first used (PEP 562), and keep it."""
        if name not in __all__:
            raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
        from importlib import import_module

        if name == "blocking":
            return import_module("ropeway.blocking")  # which makes it an attribute of the package
        home = next((module for module, names in _HOMES.items() if name in names), "ropeway.errors")
        value = globals()[name] = getattr(import_module(home), name)
        return value


def __dir__() -> list[str]:
    return sorted(__all__)


del TYPE_CHECKING
