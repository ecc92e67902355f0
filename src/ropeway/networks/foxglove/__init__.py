"""The Foxglove WebSocket protocol: viewers see and use a graph as they do with foxglove_bridge."""
