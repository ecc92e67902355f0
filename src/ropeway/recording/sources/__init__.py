"""The files that recordings are made of, each read as a stream of raw messages."""

from ropeway.recording.sources.opening import open_recording
from ropeway.recording.sources.source import DAMAGED, RecordedChannel, Recording, reason_of

__all__ = ["DAMAGED", "RecordedChannel", "Recording", "open_recording", "reason_of"]
