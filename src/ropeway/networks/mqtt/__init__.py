"""Topics of an MQTT broker as a graph: ``mqtt://host:1883``, ``mqtts://host:8883``."""
