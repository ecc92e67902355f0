"""ropeway.gateway.plan: what a change of configuration would do."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.config.config import Config, parse
from ropeway.gateway.plan import ConfigPlan, make_plan
from tests.support.messages import STRING


def item(name: str, **more: Any) -> dict[str, Any]:
    return {"name": name, "type": STRING, **more}


def made(*remotes: dict[str, Any], **settings: Any) -> Config:
    return parse({"gateway": {"name": "robot", "graphs": ["memory:p"], "listen": [], **settings}, "remotes": remotes})


def remote(address: str, *names: str, **more: Any) -> dict[str, Any]:
    return {"address": address, "publish": [item(name) for name in names], **more}


def said(plan: ConfigPlan) -> list[tuple[str, str, str]]:
    return [(step.action, step.what, step.path) for step in plan.steps]


A, B = "ws://a:1", "ws://b:1"


def test_nothing() -> None:
    """The same configuration changes nothing, however it is written."""
    plan = make_plan(made(remote(A, "/x")), made({"address": "WS://a:1", "publish": [item("x")]}))
    assert plan.empty
    assert plan.unchanged == 1


def test_routes_come_and_go() -> None:
    """Only what is added or taken away starts or stops; an insertion in front moves nobody."""
    plan = make_plan(made(remote(A, "/x", "/y")), made(remote(B, "/z"), remote(A, "/new", "/y")))
    assert said(plan) == [
        ("start", "remote", "remotes[0]"),
        ("start", "route", "remotes[0].publish[0]"),
        ("start", "route", "remotes[1].publish[0]"),
        ("stop", "route", "remotes[0].publish[0]"),
    ]
    assert plan.unchanged == 1
    assert plan.stopped == ()


def test_a_route_changes() -> None:
    """Another option of a route changes it, with both values; another type stops it and starts another."""
    old = made({"address": A, "publish": [item("/x", rate_hz=5.0), item("/y")]})
    new = made({"address": A, "publish": [item("/x", rate_hz=10.0), {"name": "/y", "type": "std_msgs/msg/Bool"}]})
    plan = make_plan(old, new)
    assert said(plan) == [
        ("start", "route", "remotes[0].publish[1]"),
        ("change", "route", "remotes[0].publish[0]"),
        ("stop", "route", "remotes[0].publish[1]"),
    ]
    assert plan.steps[1].details == ("rate_hz: 5.0 → 10.0",)
    assert plan.steps[1].interrupts == ""
    assert "readers of /y" in plan.steps[2].interrupts


def test_a_link_is_replaced() -> None:
    """What the link is made of makes another link in the place of the old one; its routes go on over it."""
    plan = make_plan(made(remote(A, "/x")), made(remote(A, "/x", remote_namespace="/robot1", ros=2)))
    assert said(plan)[0] == ("replace", "remote", "remotes[0]")
    assert 'remote_namespace: "/" → "/robot1"' in plan.steps[0].details
    assert plan.stopped == (0,)
    assert plan.remotes[0].replaces == 0
    same = make_plan(made(remote(A, "/x")), made(remote(A, "/x", ros=2)))
    assert said(same) == [("replace", "remote", "remotes[0]")]


def test_pausing() -> None:
    """A route or a remote that is not active any more stops, and starts when it is again."""
    on = made(remote(A, "/x"), remote(B, "/y"))
    off = made({"address": A, "publish": [item("/x", active=False)]}, remote(B, "/y", active=False))
    assert said(make_plan(on, off)) == [
        ("stop", "route", "remotes[0].publish[0]"),
        ("stop", "remote", "remotes[0]"),
        ("stop", "route", "remotes[1].publish[0]"),
        ("stop", "remote", "remotes[1]"),
    ]
    assert [step.action for step in make_plan(off, on).steps] == ["start"] * 4


@pytest.mark.parametrize(
    ("key", "value", "action", "restarts"),
    [
        ("globs", {"topics": ["/a"]}, "change", False),
        ("control", False, "note", False),
        ("graphs", ["memory:q"], "restart", True),
        ("max_message_bytes", 1 << 20, "restart", True),
        ("name", "other", "restart", True),
    ],
)
def test_the_gateway(key: str, value: Any, action: str, restarts: bool) -> None:
    """The plan says which of the gateway's own keys interrupt everything, and which nothing."""
    plan = make_plan(made(remote(A, "/x")), made(remote(A, "/x"), **{key: value}))
    assert said(plan)[0] == (action, "gateway", f"gateway.{key}")
    assert bool(plan.restart) is restarts


def test_routes_of_a_group() -> None:
    """A group stays while its routes come, go and pause, all of them too: it would have to find its best anew."""
    group = {"address": ["ws://a", "ws://b"], "anycast": {"responses": {"/x": "/y"}, "latency_bound": {"p90": 0.1}}}
    routes = {"publish": [item("/x")], "subscribe": [item("/y")]}
    paused = {key: [one | {"active": False} for one in items] for key, items in routes.items()}
    before = made(group | routes)
    for change in (routes | {"publish": paused["publish"]}, {"publish": routes["publish"]}, paused):
        for old, new in ((before, made(group | change)), (made(group | change), before)):
            plan = make_plan(old, new)
            assert [step.what for step in plan.steps] == ["route"] * len(plan.steps)
            assert plan.stopped == ()


def test_workers() -> None:
    """One process does not become several while it runs: the plan says what to do."""
    with pytest.raises(ConfigError, match="stop it, and run the new file"):
        make_plan(made(), made(workers=2))


def test_no_secret_is_shown() -> None:
    """A token in an address is replaced by dots."""
    plan = make_plan(made(), made(remote("ws://a:1/?token=hidden", "/x")))
    assert "hidden" not in str([step.to_json() for step in plan.steps])


def test_remotes_of_one_address() -> None:
    """Two remotes of one address are told apart by what else they are made of, equal ones by their order."""
    two = made(remote(A, "/x", remote_namespace="/one"), remote(A, "/x", remote_namespace="/two"))
    one = made(remote(A, "/x", remote_namespace="/two"))
    plan = make_plan(two, one)
    assert plan.stopped == (0,)
    assert plan.unchanged == 1


def test_expectations_change_nothing() -> None:
    """What is expected of a link or of a topic is for predictions: nothing of what runs changes with it."""
    expected = {"bytes": 100, "hz": 10}
    new = {"address": A, "link": {"mbit": 20}, "publish": [item("/x", expected=expected)]}
    assert make_plan(made(remote(A, "/x")), made(new)).empty


def test_guards_of_commands() -> None:
    """A guard of commands that a route brings needs a restart, as one of the gateway does."""
    old = {"address": A, "subscribe": [item("/x")]}
    new = {"address": A, "subscribe": [item("/x", safety={"lease_s": 0.5})]}
    plan = make_plan(made(old), made(new))
    assert plan.restart == ("gateway.safety",)
    assert said(plan) == [("restart", "gateway", "gateway.safety")]
