"""The library behind ``import ropeway``, for programs of asyncio; ``ropeway.blocking`` is the same without it.

Messages of programs become samples of graphs here, and nothing else: what moves data are the graphs and bridges below.
The names for users are those that ``ropeway`` itself exports.
"""
