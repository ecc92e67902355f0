"""Links: one WebSocket connection, what waits to be sent on it, and how fast it goes."""
