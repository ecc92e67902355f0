"""TCP, TLS, HTTP and WebSocket in front of everything that listens, and who may come in."""
