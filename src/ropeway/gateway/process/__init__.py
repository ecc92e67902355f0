"""The processes of a gateway: workers, their supervisor, and what the operating system limits."""
