"""Reports what a scheduler knows of its members: the profile, for people, programs and nodes."""

from __future__ import annotations

from typing import Any

from ropeway.group.jenks import latency_classes
from ropeway.group.scheduler import Scheduler

__all__ = ["profile_report"]


def profile_report(scheduler: Scheduler, now_s: float) -> dict[str, Any]:
    """Return the status of a scheduler with the natural classes of each member's latencies, as JSON.

    ``fit`` is the goodness of variance fit of the classes, ``None`` where nothing is known.
    """
    found = scheduler.status(now_s)
    for name, member in found["members"].items():
        latencies = scheduler.window(name).statistics(now_s)
        classes, fit = latency_classes(latencies.values) if latencies is not None else ((), None)
        member["classes"] = [one.as_json() for one in classes]
        member["fit"] = None if fit is None else round(fit, 3)
    return {"bound_s": dict(scheduler.bound.limits), **found}
