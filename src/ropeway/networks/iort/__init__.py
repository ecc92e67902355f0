"""The ``iort`` graph: robots that speak text packets, as a network of topics."""
