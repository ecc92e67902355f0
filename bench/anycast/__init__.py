"""Anycast within a latency bound, beside the thesis (Chen 2024, 5.3.2, 5.3.3, 6.1)."""
