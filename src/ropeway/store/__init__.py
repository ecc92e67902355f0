"""Keeps the last value of every topic over restarts, and merges values between sites."""

from __future__ import annotations

from ropeway.store.entry import CDR, Backend, Change, Entry, Key, SharedBackend, Versions, as_json, check_name
from ropeway.store.factory import default_path, is_mongo, make_backend, make_mirror
from ropeway.store.store import Sink, Store, StoreLimits

__all__ = [
    "CDR",
    "Backend",
    "Change",
    "Entry",
    "Key",
    "SharedBackend",
    "Sink",
    "Store",
    "StoreLimits",
    "Versions",
    "as_json",
    "check_name",
    "default_path",
    "is_mongo",
    "make_backend",
    "make_mirror",
]
