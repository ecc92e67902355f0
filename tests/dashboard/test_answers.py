"""What gateways answer is checked before a page sees it."""

from __future__ import annotations

from typing import Any

import pytest

from ropeway.dashboard.answers import StatusAnswer, ValueAnswer, read
from ropeway.errors import ControlRefused

PICTURE = {"media_type": "image/png", "base64": "QUJD"}


@pytest.mark.parametrize(
    "answer",
    [
        None,
        "hello",
        [],
        {},
        {"name": 7},
        {"name": "a", "routes": {}},
        {"name": "a", "routes": [7]},
        {"name": "a", "routes": [{"name": "/a", "rate_hz": float("nan")}]},
        {"name": "a", "routes": [{"name": "/a", "drops": {"late": "many"}}]},
        {"name": "a", "sessions": [{"peer": ["x"]}]},
    ],
)
def test_an_answer_of_another_shape(answer: Any) -> None:
    """An answer that no gateway gives is an error with a sentence, and nothing else."""
    with pytest.raises(ControlRefused, match="this is not the answer of a gateway"):
        read(StatusAnswer, answer)


def test_an_answer_of_another_version() -> None:
    """Keys that are not known are passed over, missing ones have defaults, and long texts are cut."""
    status = read(StatusAnswer, {"name": "x" * 100_000, "new": [1], "routes": [{"name": "/a"}]})
    assert len(status.name) == 501
    assert status.routes[0].rate_hz is None


@pytest.mark.parametrize("change", [{"media_type": "text/html"}, {"base64": '"><script>'}, {"base64": None}])
def test_a_picture_that_is_none(change: dict[str, Any]) -> None:
    """What is shown as a picture is a PNG or a JPEG in base64 and can be nothing else."""
    assert read(ValueAnswer, {"picture": PICTURE}).picture is not None
    with pytest.raises(ControlRefused):
        read(ValueAnswer, {"picture": {**PICTURE, **change}})
