"""The JSON Schema of a configuration, made from the models, for editors and other tools."""

from __future__ import annotations

from typing import Any, Final

from pydantic import AliasChoices, BaseModel
from pydantic.json_schema import GenerateJsonSchema, models_json_schema

from ropeway.gateway.config.audit_model import AuditConfig
from ropeway.gateway.config.auth_model import GlobsConfig, Patterns, RoleConfig
from ropeway.gateway.config.control_model import ControlConfig
from ropeway.gateway.config.graph_model import GraphConfig
from ropeway.gateway.config.model import Document
from ropeway.gateway.config.record_model import RecordConfig
from ropeway.gateway.config.route_model import ActionItem, RenamedTopicItem, ServiceItem, TopicItem

__all__ = ["build"]

_DURATION: Final = {
    "anyOf": [
        {"type": "number", "minimum": 0},
        {"enum": ["infinite", "best_available", None]},
        {
            "type": "object",
            "required": ["secs", "nsecs"],
            "properties": {"secs": {"type": "number"}, "nsecs": {"type": "number"}},
        },
    ]
}
_ITEMS: Final[tuple[type[BaseModel], ...]] = (
    TopicItem,
    RenamedTopicItem,
    ServiceItem,
    ActionItem,
    Patterns,
    RoleConfig,
    GlobsConfig,
)


class _Plain(GenerateJsonSchema):
    """Leaves out the generated titles, which editors would show instead of the descriptions."""

    def field_title_should_be_set(self, schema: Any) -> bool:
        return False


def build() -> dict[str, Any]:
    """Build the schema of all three forms: the full object, a list of remotes, one remote."""
    models: tuple[type[BaseModel], ...] = (Document, GraphConfig, ControlConfig, AuditConfig, RecordConfig, *_ITEMS)
    _, made = models_json_schema([(model, "validation") for model in models], schema_generator=_Plain)
    definitions: dict[str, Any] = made["$defs"]
    for model in _ITEMS:
        _spell(definitions[model.__name__], model)
    for definition in definitions.values():
        definition.pop("title", None)
    definitions["Duration"] = _DURATION
    document = definitions.pop("Document")
    gateway = definitions["GatewayConfig"]["properties"]
    gateway["name"]["pattern"] = "^[A-Za-z_][A-Za-z0-9_]*$"
    for holder in (definitions["RemoteConfig"], document):
        holder["properties"]["anycast"]["anyOf"].append({"type": "string"})  # the name of a file
    remote = {"$ref": "#/$defs/RemoteConfig"}
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Ropeway configuration",
        "anyOf": [{"type": "array", "items": remote}, remote, document, _fleet(document)],
        "$defs": definitions,
    }


def _fleet(document: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a document with many gateways, each in the full form."""
    host = {"type": "string", "description": "where others reach it, for the checks across"}
    properties = {key: value for key, value in document["properties"].items() if key != "$schema"}
    one = {**document, "properties": {"host": host, **properties}}
    gateways = {"type": "object", "minProperties": 1, "additionalProperties": one}
    described = {**gateways, "description": "many gateways by name; ropeway run FILE --as NAME runs one"}
    return {
        "type": "object",
        "additionalProperties": False,
        "required": ["gateways"],
        "properties": {"$schema": document["properties"]["$schema"], "gateways": described},
    }


def _spell(definition: dict[str, Any], model: type[BaseModel]) -> None:
    """Add the other spellings of keys, of which one at most may stand."""
    properties, required = definition["properties"], definition.setdefault("required", [])
    rules: list[dict[str, Any]] = []
    for info in model.model_fields.values():
        if not isinstance(info.validation_alias, AliasChoices):
            continue
        first, *others = [str(choice) for choice in info.validation_alias.choices]
        for other in others:
            properties[other] = {**properties[first], "description": f'another spelling of "{first}"'}
        one_of = [{"required": [spelling]} for spelling in (first, *others)]
        if first in required:
            required.remove(first)
            rules.append({"oneOf": one_of})
        else:
            rules.append({"not": {"required": [first, *others]}})
    definition["allOf"] = rules
    if not required:
        del definition["required"]
