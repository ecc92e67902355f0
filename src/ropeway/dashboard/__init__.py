"""Pages in a browser about running gateways: a process of its own, and a client of their control APIs."""
