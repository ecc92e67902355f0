"""Groups: several graphs that offer the same names count as one, and a policy says which of them answers."""
