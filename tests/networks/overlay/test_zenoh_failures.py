"""Failures of Zenoh that Python does not know."""

from __future__ import annotations

import pytest

from ropeway.errors import GraphUnavailable
from ropeway.networks.overlay.zenoh_failures import zenoh_failures


class PanicException(BaseException):
    """What a panic of Zenoh raises: by this name, and of a class that cannot be imported."""


def test_a_panic() -> None:
    """A panic of Zenoh is an error like others; whatever else is raised stays what it is."""
    with pytest.raises(GraphUnavailable, match="Zenoh has failed"), zenoh_failures():
        raise PanicException
    with pytest.raises(KeyError), zenoh_failures():
        raise KeyError
