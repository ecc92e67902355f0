"""ROS 2 on the loopback interface, with whatever middleware the tests are run with."""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

DOMAIN = 60 + os.getpid() % 40

_CYCLONE = """<CycloneDDS><Domain id="any">
<General><Interfaces><NetworkInterface name="lo"/></Interfaces><AllowMulticast>false</AllowMulticast></General>
<Discovery><Tag>ros2-test-{pid}</Tag><ParticipantIndex>auto</ParticipantIndex>
<MaxAutoParticipantIndex>40</MaxAutoParticipantIndex><Peers><Peer address="localhost"/></Peers></Discovery>
</Domain></CycloneDDS>"""


@contextmanager
def isolated_ros2() -> Iterator[int]:
    """Contexts made meanwhile, also in child processes, stay on this machine; gives a domain for them."""
    with pytest.MonkeyPatch.context() as patch:
        cyclone = "cyclone" in os.environ.get("RMW_IMPLEMENTATION", "")
        patch.setenv("CYCLONEDDS_URI", _CYCLONE.format(pid=os.getpid()))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "SYSTEM_DEFAULT" if cyclone else "LOCALHOST")
        patch.setenv("ROS_DOMAIN_ID", str(DOMAIN))
        for name in ("ROS_LOCALHOST_ONLY", "ROS_STATIC_PEERS"):
            patch.delenv(name, raising=False)
        yield DOMAIN
