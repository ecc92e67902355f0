"""Topics and services as REST resources, on the ports of the rosbridge listeners."""
