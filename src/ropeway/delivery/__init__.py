"""The way of a message: the steps it goes through, the outbox it waits in, and how it is encoded."""
