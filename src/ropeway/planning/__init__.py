"""Predicts what links carry: the rate, bandwidth and delay of every topic before anything runs.

``TrafficPlan`` says which hosts publish and read which topics over which links; ``predict`` returns a row per topic and
encoding. The Gateway paper's equations stand in ``equations``.
"""

from __future__ import annotations

from ropeway.planning.equations import (
    DEFAULT_LZ4_RATIO,
    bandwidth_bps,
    gateway_bandwidth_bps,
    received_rate_hz,
    shared_rates_hz,
)
from ropeway.planning.plan import PlannedLink, PlannedTopic, TrafficPlan
from ropeway.planning.prediction import Prediction, predict

__all__ = [
    "DEFAULT_LZ4_RATIO",
    "PlannedLink",
    "PlannedTopic",
    "Prediction",
    "TrafficPlan",
    "bandwidth_bps",
    "gateway_bandwidth_bps",
    "predict",
    "received_rate_hz",
    "shared_rates_hz",
]
