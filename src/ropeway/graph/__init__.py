"""Graphs: everything that has topics, services and actions, one module per kind of network."""
