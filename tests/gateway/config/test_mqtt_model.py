"""ropeway.gateway.config.mqtt_model: topics of a broker in a configuration."""

from __future__ import annotations

from ropeway.gateway.config import config
from ropeway.networks.mqtt.maps import MqttMap


def test_as_map() -> None:
    """An item of topics is a map with its form's options, and a graph with topics is written out with them."""
    item = {"topic": "a/+", "type": "geometry_msgs/Twist", "form": "json", "fields": {"linear.x": "v"}}
    graph = {"address": "mqtt://broker", "topics": [item]}
    parsed = config.parse({"gateway": {"graphs": [graph], "listen": []}, "remotes": []})
    (network,) = parsed.gateway.networks
    wanted = MqttMap("a/+", "geometry_msgs/msg/Twist", "json", options={"fields": {"linear.x": "v"}})
    assert network.topics[0].as_map() == wanted
    written = network.model_dump()
    assert config.parse({"gateway": {"graphs": [written], "listen": []}, "remotes": []}).gateway.networks == (network,)
