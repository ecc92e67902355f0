"""Graphs within one process, for tests, examples and demos: the smallest network there is."""
