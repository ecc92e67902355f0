"""Keeps the DDS participants of a test run to themselves."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest


@contextmanager
def isolated_dds() -> Iterator[None]:
    """Participants made meanwhile, also in child processes, discover each other and no other test run."""
    tag = f"<CycloneDDS><Domain><Discovery><Tag>test-{os.getpid()}</Tag></Discovery></Domain></CycloneDDS>"
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("CYCLONEDDS_URI", tag)
        for name in ("ROS_AUTOMATIC_DISCOVERY_RANGE", "ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"):
            patch.delenv(name, raising=False)
        yield
