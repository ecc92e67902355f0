"""Gives metrics to Prometheus."""

from __future__ import annotations

from typing import Any, Final

from ropeway.control.resource import Answer, ControlRequest, Resources

__all__ = ["PATH", "resources"]

resources = Resources()

PATH: Final = "/metrics"
_TEXT: Final = "text/plain"


@resources.get(PATH, media_type=_TEXT)
async def metrics(asked: ControlRequest) -> Any:
    """Return all counters, gauges and histograms as Prometheus and OpenMetrics read them."""
    writer = await asked.manager.metrics()
    body, media_type = writer.text(asked.headers.get("accept", ""))
    return Answer(body, media_type=media_type)
