"""ropeway.qos: what several publishers have in common."""

from __future__ import annotations

from dataclasses import replace

from ropeway.limits import QOS_DEPTH_SAMPLES
from ropeway.qos import DEFAULT, LATCHED, PROFILES, SENSOR_DATA, QoS, adopted, common_qos, unmet


def test_nothing_offered() -> None:
    """Where nobody offers anything, the fallback is taken."""
    assert common_qos([], LATCHED) == LATCHED
    assert common_qos([]) == DEFAULT


def test_weakest_wins() -> None:
    """A reader asks for no more than every publisher gives, and is as deep as the deepest."""
    assert common_qos([QoS(depth=3), SENSOR_DATA]) == QoS(reliability="best_effort", depth=5)
    assert common_qos([LATCHED, QoS(depth=3)]) == QoS(depth=3)
    assert common_qos([QoS(history="keep_all"), QoS()]).history == "keep_all"


def test_latched_by_several() -> None:
    """What each of several publishers has latched has room."""
    assert common_qos([LATCHED, LATCHED, QoS(durability="transient_local", depth=5)]).depth == 7


def test_untold_depth() -> None:
    """A depth that was not told counts as the usual one."""
    assert common_qos([QoS(depth=0)]).depth == 10
    assert common_qos([QoS(durability="transient_local", depth=0)] * 2).depth == 20


def test_lifespan_of_latched_messages() -> None:
    """What every publisher keeps for a time only is not latched."""
    brief = QoS(durability="transient_local", depth=100, lifespan_s=1.0)
    assert common_qos([brief, brief]).lifespan_s == 1.0
    assert not common_qos([brief]).latched
    assert common_qos([brief, LATCHED]).latched
    assert common_qos([QoS(lifespan_s=1.0)]).lifespan_s is None


def test_depth_is_bounded() -> None:
    """No profile is deeper than the limit, however it is made."""
    deep = 2**31 - 1
    assert QoS(depth=deep).depth == QOS_DEPTH_SAMPLES
    assert QoS.parse({"depth": deep}).depth == QOS_DEPTH_SAMPLES
    assert replace(QoS(), depth=deep).depth == QOS_DEPTH_SAMPLES
    latched = QoS(durability="transient_local", depth=QOS_DEPTH_SAMPLES)
    assert common_qos([latched, latched]).depth == QOS_DEPTH_SAMPLES


def test_unmet_policies() -> None:
    """A reader does not match a writer that offers less than it asks for, and the policies are named."""
    assert unmet(SENSOR_DATA, None) == ()
    assert unmet(DEFAULT, SENSOR_DATA) == unmet(LATCHED, DEFAULT) == ()
    assert unmet(SENSOR_DATA, LATCHED) == ("reliability", "durability")
    assert unmet(SENSOR_DATA, PROFILES["best_available"]) == ()
    assert unmet(QoS(deadline_s=2.0), QoS(deadline_s=1.0)) == unmet(DEFAULT, QoS(deadline_s=1.0)) == ("deadline",)
    assert unmet(QoS(deadline_s=1.0), QoS(deadline_s=2.0)) == ()


def test_what_is_offered_satisfies_what_is_asked_for() -> None:
    """An offer satisfies a request that is no stronger in any policy, and any request for whatever there is."""
    best_effort = QoS(reliability="best_effort")
    assert QoS().satisfies(best_effort)
    assert not best_effort.satisfies(QoS())
    assert not QoS().satisfies(QoS(durability="transient_local"))
    assert best_effort.satisfies(None)
    assert best_effort.satisfies(PROFILES["best_available"])


def test_adopts_what_was_not_asked_for() -> None:
    """Without a request all of what is offered is adopted, with best available policies these alone."""
    offers = [QoS(reliability="best_effort", depth=3), QoS(durability="transient_local", depth=7)]
    assert adopted(None, offers) == common_qos(offers)
    assert adopted(None, [], LATCHED) == LATCHED
    assert adopted(LATCHED, offers) == LATCHED
    asked = QoS(reliability="best_available", depth=4)
    assert adopted(asked, offers) == QoS(reliability="best_effort", depth=4)
