"""Bridges join one name on two graphs; nothing else in the system moves data."""
