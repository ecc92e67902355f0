"""A topic that goes by the best of several links, and again by another one if that one may have been cut."""

from __future__ import annotations

from functools import cached_property

from ropeway.graph.base import SEQ_NONE, Sample
from ropeway.graph.parts import numbered
from ropeway.group.recent import Recent
from ropeway.group.topics import GroupPublisher

__all__ = ["LinkPublisher"]


class LinkPublisher(GroupPublisher):
    """Keeps its last messages for a moment, so that another link can bring those that one has lost.

    The far side drops what it has: a message has the same number on all links.
    """

    @cached_property
    def _recent(self) -> Recent[Sample]:
        """The messages that were published last."""
        return Recent()

    def publish(self, sample: Sample) -> None:
        """See ``GroupPublisher.publish``."""
        if sample.seq == SEQ_NONE:
            sample = numbered(sample, self.type, self._origin, self._seq)
            self._seq = sample.seq
        self._recent.note(sample, len(sample.payload), self._group.now())
        super().publish(sample)

    def send_again(self, name: str, since_s: float) -> None:
        """Send by a link what was sent since then, in order."""
        part = self._parts.get(name)
        if part is not None:
            for sample in self._recent.take(since_s):
                part.publish(sample)
