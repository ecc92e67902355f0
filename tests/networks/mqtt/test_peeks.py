"""ropeway.networks.mqtt.peeks: whether a broker keeps a value of a topic that nobody announces."""

from __future__ import annotations

from ropeway.limits import MQTT_PEEKS
from ropeway.qos import LATCHED
from tests.support.until import until

from .conftest import Place


async def test_found_out(place: Place) -> None:
    """Who asks for a topic learns that the broker keeps a value of it, also on the next connection."""
    graph, device = await place.graph(), place.device()
    device.publish("kept", "x", retain=True)
    for _ in range(2):
        assert graph.look_up("topic", "/kept") is None
        await until(lambda: graph.look_up("topic", "/kept") is not None)
        assert graph.offered("/kept") == [LATCHED]
        graph.connection.renew(graph.connection.plan, anew=True)
        await until(lambda: not graph.offered("/kept"))
        await until(lambda: graph.connected)
        await until(lambda: graph.offered("/kept"))
        graph.discovery.clear()
        graph.peeks._wanted.clear()
    await until(lambda: not graph.connection._wishes.keys() - {"ropeway/+"})


async def test_bounded(place: Place) -> None:
    """Names that are no topics are not looked at, nor more than there may be."""
    graph = await place.graph()
    graph.look_up("topic", "/_x23_")
    assert not graph.peeks._wanted
    for number in range(MQTT_PEEKS + 10):
        graph.look_up("topic", f"/t{number}")
    assert len(graph.peeks._wanted) == MQTT_PEEKS
