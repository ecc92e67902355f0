"""Measurements: what the gateway costs and what it reaches, as ratios within one run."""
