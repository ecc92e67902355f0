"""Lists the reasons for which the overlay refuses something; every refusal is counted under one of them."""

from __future__ import annotations

import enum

__all__ = ["Refusal"]


class Refusal(enum.Enum):
    """A reason, as a phrase for people."""

    UNKNOWN_CA = "its certificate is not of this fleet"
    EXPIRED = "it has expired"
    NOT_YET_VALID = "it is not valid yet; compare the clocks"
    REVOKED = "its certificate was revoked"
    WRONG_PURPOSE = "its certificate was issued for another purpose"
    BAD_SIGNATURE = "its signature does not match"
    UNPROVEN = "its publisher proves it to other readers, and not to us"
    BAD_TAG = "it was altered, or sealed with another key"
    REPLAYED = "it came before"
    TOO_OLD = "it is older than what is still expected"
    TOO_BIG = "it is larger than what is taken"
    TRUNCATED = "it is cut short"
    WRONG_NAME = "it belongs to another name"
    NO_RIGHT = "its sender has no right to do this"
    NO_KEY = "its key is not known here"
    MALFORMED = "it is not in the expected form"
