"""Errors of topics, in the words of rosbridge."""

from __future__ import annotations

from ropeway.errors import GraphError, TypeConflict

__all__ = ["TopicTypeConflict", "UnknownTopicError"]


class UnknownTopicError(GraphError):
    """A topic whose type nobody has told."""

    def __init__(self, topic: str) -> None:
        self.topic = topic
        super().__init__(
            f"Cannot infer topic type for topic {topic} as it is not yet advertised; give its type in the request"
        )


class TopicTypeConflict(TypeConflict):
    """A topic that has another type already; the text is that of rosbridge."""

    def __str__(self) -> str:
        return (
            f"Tried to register topic {self.name} with type {self.offered}"
            f" but it is already established with type {self.known}"
        )
