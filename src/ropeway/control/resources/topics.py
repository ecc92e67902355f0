"""The topics of the gateway's networks: list them, look at the newest message of one, publish on one."""

from __future__ import annotations

from typing import Any

from pydantic import BaseModel, ConfigDict, Field

from ropeway.control.resource import Audited, ControlRequest, Resources
from ropeway.errors import ControlRefused, InvalidName
from ropeway.gateway.process import topic_questions
from ropeway.graph.base import resolve_name

__all__ = ["resources"]

resources = Resources()


class MessageBody(BaseModel):
    """A message to publish. ``driver`` tells several apart who command one robot: one of them holds the lease."""

    model_config = ConfigDict(extra="forbid")

    name: str = Field(description="of the topic")
    type: str = Field(description="of the message, as in geometry_msgs/msg/Twist", max_length=300)
    message: dict[str, Any] = Field(description="its fields; those left out have their defaults")
    graph: str = Field("", description="the network, where the gateway has several", max_length=1000)
    driver: str = Field("", description="whoever commands, a word of your own", max_length=100)


@resources.get("/v1/topics", gives=list[dict[str, Any]])
async def list_topics(asked: ControlRequest) -> Any:
    """Return the topics of all networks that the caller may read or publish."""
    role = asked.caller.role
    found = await asked.manager.ask_one(topic_questions.list_topics, {})
    return [
        topic
        for topic in found
        if not (role.rule_against("subscribe", topic["name"]) and role.rule_against("publish", topic["name"]))
    ]


@resources.get("/v1/topics/value", gives=dict[str, Any])
async def read_value(asked: ControlRequest) -> Any:
    """Return the newest message of ``?name=`` on ``&graph=``, if it is one behind the ``count`` in ``&after=``.

    Long arrays are cut, and of an image there is a small picture. The first answer has no message yet: the topic is
    read from then on, as long as somebody asks.
    """
    name = _name(asked.query.get("name", ""))
    asked.caller.demand_topic("subscribe", name)
    after = asked.query.get("after", "") or "0"
    if not (after.isascii() and after.isdigit() and len(after) < 18):
        raise ControlRefused(422, f"after: expected a number, got {after[:20]}")
    params = {"name": name, "graph": asked.query.get("graph", ""), "after": int(after)}
    return _good(await asked.manager.ask_one(topic_questions.look_at_topic, params))


@resources.post(
    "/v1/topics/publish", right="operate", takes=MessageBody, gives=dict[str, Any], audited=Audited("publish")
)
async def publish(asked: ControlRequest) -> Any:
    """Publish a message; the topic stays published for some seconds, so that more may follow.

    A command lease (``safety``) guards it as it guards commands over a link. Returns the number of readers.
    """
    body: MessageBody = asked.body
    name = asked.noted["name"] = _name(body.name)
    asked.caller.demand_topic("publish", name)
    params = {**body.model_dump(), "name": name, "driver": f"{asked.caller.name} {body.driver}".strip()}
    return _good(await asked.manager.ask_one(topic_questions.publish_message, params))


def _name(text: str) -> str:
    try:
        return resolve_name(text)
    except InvalidName as error:
        raise ControlRefused(422, f"name: {error.reason}") from None


def _good(answer: dict[str, Any]) -> dict[str, Any]:
    if "error" in answer and "count" not in answer:
        raise ControlRefused(409, answer["error"])
    return answer
