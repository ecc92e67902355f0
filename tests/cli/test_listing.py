"""Lists of services and actions."""

from __future__ import annotations

import json

import pytest

from ropeway.cli.listing import print_list
from ropeway.graph.calls import ProviderInfo, ServiceInfo

INFOS = [
    ServiceInfo("/b", ("p/srv/B", "p/srv/C"), (ProviderInfo("/n"),), (ProviderInfo(local=True),)),
    ServiceInfo("/a", ("p/srv/A",)),
    ServiceInfo("/x/_action/get_result", ("p/action/X_GetResult",)),
]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({}, "/a\n/b\n"),
        ({"show_types": True}, "/a [p/srv/A]\n/b [p/srv/B, p/srv/C]\n"),
        ({"count": True}, "2\n"),
        ({"include_hidden": True}, "/a\n/b\n/x/_action/get_result\n"),
    ],
)
def test_print_list(options: dict[str, bool], said: str, capsys: pytest.CaptureFixture[str]) -> None:
    """Names are listed in order, hidden ones when asked for."""
    print_list(INFOS, **{"show_types": False, "count": False, "include_hidden": False, "as_json": False, **options})
    assert capsys.readouterr().out == said


def test_json_list(capsys: pytest.CaptureFixture[str]) -> None:
    """The JSON form counts who serves and uses them, ours left out."""
    print_list(INFOS, show_types=False, count=False, include_hidden=False, as_json=True)
    assert json.loads(capsys.readouterr().out) == [
        {"name": "/a", "types": ["p/srv/A"], "servers": 0, "clients": 0},
        {"name": "/b", "types": ["p/srv/B", "p/srv/C"], "servers": 1, "clients": 0},
    ]
