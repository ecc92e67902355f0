"""Tests of networks on rmw_zenoh."""
