"""The files that recordings are made of, each read as a stream of raw messages."""

from ropeway.cli.recording.files import open_recording
from ropeway.cli.recording.source import DAMAGED, Channel, Source, reason_of

__all__ = ["DAMAGED", "Channel", "Source", "open_recording", "reason_of"]
