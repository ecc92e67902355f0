"""The pages of the dashboard: one module each, which adds its page to the table in ``frame``."""
