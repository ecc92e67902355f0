"""The audit log: who changed, commanded, was denied or was disconnected; bounded, and never in the way of data."""
