"""Describes the control API as OpenAPI 3.1, from the table of resources and the models that they take and give."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import Any, Final

from pydantic import BaseModel, TypeAdapter

from ropeway import __version__
from ropeway.control.resource import Resource

__all__ = ["document"]

_TEMPLATE: Final = "#/components/schemas/{model}"
_ERROR: Final = {
    "type": "object",
    "required": ["error"],
    "properties": {
        "error": {"type": "string", "description": "what is wrong, and what to do"},
        "problems": {
            "type": "array",
            "items": {
                "type": "object",
                "properties": {"path": {"type": "string"}, "problem": {"type": "string"}},
            },
        },
    },
}


def document(resources: Sequence[Resource]) -> dict[str, Any]:
    """Return the OpenAPI document of all resources."""
    schemas: dict[str, Any] = {"Error": _ERROR}
    paths: dict[str, Any] = {}
    for resource in resources:
        paths.setdefault(resource.path, {})[resource.method.lower()] = _operation(resource, schemas)
    return {
        "openapi": "3.1.0",
        "info": {
            "title": "Ropeway control API",
            "version": __version__,
            "description": "Shows and changes a running gateway. Requests that change something are in JSON.",
        },
        "paths": paths,
        "components": {
            "schemas": schemas,
            "securitySchemes": {
                "token": {"type": "http", "scheme": "bearer"},
                "certificate": {"type": "mutualTLS"},
            },
        },
        "security": [{}, {"token": []}, {"certificate": []}],
    }


def _operation(resource: Resource, schemas: dict[str, Any]) -> dict[str, Any]:
    operation: dict[str, Any] = {
        "operationId": resource.handler.__name__,
        "summary": resource.summary,
        "description": f'Needs the right "{resource.right}".',
        "responses": {
            "200": {
                "description": "done",
                "content": {resource.media_type: {"schema": _schema(resource.gives, schemas)}},
            },
            "default": {
                "description": "an error",
                "content": {"application/json": {"schema": {"$ref": _TEMPLATE.format(model="Error")}}},
            },
        },
    }
    parameters = [
        {"name": name, "in": "path", "required": True, "schema": {"type": "string"}}
        for name in re.findall(r"\{(\w+)", resource.path)
    ]
    if parameters:
        operation["parameters"] = parameters
    if resource.takes is not None:
        operation["requestBody"] = {
            "required": True,
            "content": {"application/json": {"schema": _schema(resource.takes, schemas)}},
        }
    return operation


def _schema(kind: Any, schemas: dict[str, Any]) -> dict[str, Any]:
    """Return the schema of a type; models go to ``schemas`` and are referred to."""
    if kind is None:
        return {}
    made = TypeAdapter(kind).json_schema(ref_template=_TEMPLATE)
    schemas.update(made.pop("$defs", {}))
    if isinstance(kind, type) and issubclass(kind, BaseModel):
        schemas[kind.__name__] = made
        return {"$ref": _TEMPLATE.format(model=kind.__name__)}
    return made
