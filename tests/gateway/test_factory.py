"""What runs a configuration: a gateway in this process, or workers."""

from __future__ import annotations

import subprocess
import sys

from ropeway.gateway.config.config import parse
from ropeway.gateway.factory import make_gateway
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.process.supervisor import Supervisor


def test_as_the_configuration_says() -> None:
    """Without workers it is a gateway, with workers a supervisor."""
    assert isinstance(make_gateway(parse({"gateway": {"graphs": ["memory:a"]}})), Gateway)
    assert isinstance(make_gateway(parse({"gateway": {"graphs": ["memory:a"], "workers": 2}})), Supervisor)


def test_a_supervisor_loads_no_network() -> None:
    """A process that only supervises does not load what its workers need."""
    program = (
        "import sys; from ropeway.gateway.config.config import parse; from ropeway.gateway.factory import make_gateway;"
        "make_gateway(parse({'gateway': {'workers': 2}})); print('ropeway.gateway.gateway' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True, timeout=60)
    assert done.stdout == "False\n"
