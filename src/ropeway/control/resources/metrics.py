"""Gives metrics to Prometheus."""

from __future__ import annotations

from typing import Any, Final

from ropeway.control.resource import Answer, ControlRequest, Resources

__all__ = ["resources"]

resources = Resources()

_TEXT: Final = "text/plain"


@resources.get("/metrics", media_type=_TEXT)
async def metrics(asked: ControlRequest) -> Any:
    """Return all counters and gauges as Prometheus and OpenMetrics read them."""
    from prometheus_client import CollectorRegistry
    from prometheus_client.exposition import choose_encoder

    from ropeway.control.metrics import StatusCollector

    encode, media_type = choose_encoder(asked.headers.get("accept", ""))
    registry = CollectorRegistry(auto_describe=False)
    registry.register(StatusCollector(asked.manager.status))
    return Answer(encode(registry), media_type=media_type)
