"""``node info`` as text."""

from __future__ import annotations

from ropeway.cli.node.info import info_text, sections
from ropeway.graph.base import NodeInfo
from ropeway.graph.calls import ActionInfo, ProviderInfo

NODE = NodeInfo(
    "/turtle",
    publishers=(("/rosout", "rcl_interfaces/msg/Log"), ("/pose", "a/msg/Pose")),
    services=(("/reset", "std_srvs/srv/Empty"), ("/turn/_action/send_goal", "a/action/Turn_SendGoal")),
)
ACTIONS = {
    "/turn": ActionInfo("/turn", ("a/action/Turn",), (ProviderInfo("/turtle"),), (ProviderInfo("/other"),)),
    "/walk": ActionInfo("/walk", ("a/action/Walk",), (ProviderInfo("/other"),)),
}


def test_info() -> None:
    """Topics, services and actions stand under the titles of ROS, in order; hidden ones are left out."""
    assert info_text("/turtle", sections(NODE, ACTIONS)) == (
        "/turtle\n  Subscribers:\n\n  Publishers:\n    /pose: a/msg/Pose\n    /rosout: rcl_interfaces/msg/Log\n"
        "  Service Servers:\n    /reset: std_srvs/srv/Empty\n  Service Clients:\n\n"
        "  Action Servers:\n    /turn: a/action/Turn\n  Action Clients:\n"
    )


def test_hidden() -> None:
    """Hidden names are shown when asked for."""
    assert len(sections(NODE, ACTIONS, include_hidden=True)["Service Servers"]) == 2
