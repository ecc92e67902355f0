"""Certificates, keys and sealed packets of a fleet, without I/O."""
