"""Reversible filters that make images and arrays of numbers compress better."""
