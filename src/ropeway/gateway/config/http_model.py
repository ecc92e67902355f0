"""Says what goes to web servers: topics that are posted, and URLs that are offered as services (``gateway.http``)."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import urlsplit

from pydantic import AfterValidator, AliasChoices, Field, model_validator

from ropeway.gateway.config.auth_model import Secret
from ropeway.gateway.config.fields import ExistingPath, Model
from ropeway.gateway.config.route_fields import Name, Seconds
from ropeway.gateway.config.suggest import show

__all__ = ["AnswerTopic", "HttpRule"]


def _url(value: str) -> str:
    try:
        parts = urlsplit(value)
        fits = parts.scheme in ("http", "https") and bool(parts.hostname) and (parts.port or 1) > 0
    except ValueError:
        fits = False
    if not fits or "@" in value:
        raise ValueError(f"expected http://host/path or https://host/path, and no password in it, got {show(value)}")
    return value


class AnswerTopic(Model):
    """A topic that gets the answers of a server, as JSON of its type."""

    topic: Name = Field(description="its name")
    type: str = Field(description="its type")


class HttpRule(Model):
    """Posts the messages of a topic to a URL, or offers a URL as a service."""

    url: Annotated[str, AfterValidator(_url)] = Field(
        validation_alias=AliasChoices("url", "service_uri"), description="http:// or https://, to which is posted"
    )
    topic: Name | None = Field(None, description="the topic whose messages are posted, the newest where it is slower")
    service: Name | None = Field(None, description="the service that the URL is offered as")
    type: str = Field(description="the type of the topic or the service")
    answer: AnswerTopic | None = Field(None, description="of a topic: where the answers are published")
    timeout_s: Seconds = Field(10.0, description="for the whole answer")
    attempts: int = Field(3, ge=1, le=10, description="how often a message is posted at most, later and later")
    token: Secret | None = Field(None, description='shown as Bearer: {"env": "NAME"} or {"file": "PATH"}')
    ca: ExistingPath | None = Field(None, description="the authorities to trust; default: those of the system")

    @model_validator(mode="after")
    def _one(self) -> HttpRule:
        if (self.topic is None) == (self.service is None):
            raise ValueError('expected "topic" or "service", and not both')
        if self.answer is not None and self.topic is None:
            raise ValueError("answer is for topics; a service answers its caller")
        if self.token is not None and not self.url.startswith("https:"):
            raise ValueError("a token needs an https:// URL")
        return self
