"""Coverage-guided fuzzing of everything that reads bytes of others; see ``python -m fuzz --help``."""
