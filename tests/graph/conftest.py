from __future__ import annotations

from tests.networks.rosbridge.client.conftest import fake

__all__ = ["fake"]
