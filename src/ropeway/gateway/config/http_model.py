"""Says what goes to web servers: topics that are posted, and URLs that are offered as services (``gateway.http``)."""

from __future__ import annotations

import re
from typing import Annotated, Any, Final, Literal
from urllib.parse import urlsplit

from pydantic import AfterValidator, AliasChoices, Field, model_validator

from ropeway.gateway.config.auth_model import Secret
from ropeway.gateway.config.field_path import parse_field_path
from ropeway.gateway.config.fields import ExistingPath, Many, Model
from ropeway.gateway.config.route_fields import Name, Seconds
from ropeway.gateway.config.suggest import show

__all__ = ["AnswerTopic", "AnsweredField", "HttpRule", "PostedField", "PostedFile"]

_HEADER: Final = re.compile(r"[A-Za-z0-9!#$%&'*+.^_`|~-]+")
_OURS: Final = frozenset(
    ("connection", "content-length", "content-type", "host", "trailer", "transfer-encoding", "upgrade")
)
_SECRETS: Final = frozenset(("authorization", "cookie", "proxy-authorization", "x-api-key"))


def _url(value: str) -> str:
    try:
        parts = urlsplit(value)
        fits = parts.scheme in ("http", "https") and bool(parts.hostname) and (parts.port or 1) > 0
    except ValueError:
        fits = False
    if not fits or "@" in value:
        raise ValueError(f"expected http://host/path or https://host/path, and no password in it, got {show(value)}")
    return value


def _path(value: str) -> str:
    parse_field_path(value)
    return value


def _header(name: str) -> str:
    if not _HEADER.fullmatch(name) or name.lower() in _OURS:
        raise ValueError(f"expected the name of a header that is not set anyway, got {show(name)}")
    return name


def _header_value(value: str) -> str:
    if not all(" " <= c <= "~" for c in value):
        raise ValueError("expected printable ASCII characters")
    return value


PathText = Annotated[str, AfterValidator(_path)]
HeaderName = Annotated[str, AfterValidator(_header), Field(max_length=100)]
HeaderValue = Annotated[str, AfterValidator(_header_value), Field(max_length=4096)]


class PostedField(Model):
    """Takes a field of a message, or a value that is always the same, to a field of the body that is posted."""

    source: PathText | None = Field(None, alias="from", description="the path of a field; empty for all of it")
    value: Any = Field(None, description="instead of from: what is always posted; ${NAME} in a text is a variable")
    to: PathText = Field(description="the path in the body; empty for the whole body")

    @model_validator(mode="after")
    def _one_source(self) -> PostedField:
        if (self.source is None) == (self.value is None):
            raise ValueError('expected "from" or "value", and not both')
        return self


class AnsweredField(PostedField):
    """Takes a field of an answer, or of the message that was posted, to a field of the message that is published."""

    of: Literal["answer", "message"] = Field("answer", description="what the path in from leads into")


class PostedFile(Model):
    """Posts a picture, or a field of bytes, as a file of a form."""

    source: PathText = Field(
        "", alias="from", description="a field of bytes; empty for the picture of an Image or a CompressedImage"
    )
    name: str = Field("file", min_length=1, max_length=100, description="the name of the field in the form")


class AnswerTopic(Model):
    """A topic that gets the answers of a server: JSON, or a picture where it is a CompressedImage."""

    topic: Name = Field(description="its name")
    type: str = Field(description="its type")
    fields: Many[AnsweredField] = Field((), description="which fields get what; the whole answer without")


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
    fields: Many[PostedField] = Field((), description="of a topic: what is posted; the whole message without")
    files: Many[PostedFile] = Field((), description="of a topic: posted as files of a form (multipart/form-data)")
    headers: dict[HeaderName, HeaderValue] = Field(
        default_factory=dict, description="sent with each request; ${NAME} is a variable of the environment"
    )
    attempts: int = Field(3, ge=1, le=10, description="how often a message is posted at most, later and later")
    token: Secret | None = Field(None, description='shown as Bearer: {"env": "NAME"} or {"file": "PATH"}')
    ca: ExistingPath | None = Field(None, description="the authorities to trust; default: those of the system")

    @model_validator(mode="after")
    def _one(self) -> HttpRule:
        if (self.topic is None) == (self.service is None):
            raise ValueError('expected "topic" or "service", and not both')
        for key in ("answer", "fields", "files"):
            if getattr(self, key) and self.topic is None:
                raise ValueError(f"{key} is for topics; a service has the whole request, and answers its caller")
        secret = self.token is not None or not _SECRETS.isdisjoint(map(str.lower, self.headers))
        if secret and not self.url.startswith("https:"):
            raise ValueError("a token needs an https:// URL")
        return self
