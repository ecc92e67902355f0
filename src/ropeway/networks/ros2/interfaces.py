"""The Python classes of messages and services, by the names of their types."""

from __future__ import annotations

import asyncio
import importlib
from collections.abc import Callable
from typing import Any, Final

from ropeway.errors import UnknownType
from ropeway.types.definition import canonical_name

__all__ = ["loaded", "message_class", "service_class"]

# Parts of an action, and what rosidl calls them in its class.
_ACTION_SERVICES: Final = {"_SendGoal": "SendGoalService", "_GetResult": "GetResultService"}
_ACTION_MESSAGES: Final = {"_FeedbackMessage": "FeedbackMessage"}


def message_class(type: str) -> Any:
    """Return the class of ``pkg/msg/Name``, or of an action's feedback message.

    Raises ``UnknownType`` with what to install, ``InvalidTypeName``.
    """
    return _find(canonical_name(type), _ACTION_MESSAGES)


def service_class(type: str) -> Any:
    """Return the class of ``pkg/srv/Name``, or of a service of an action. Raises as ``message_class``."""
    return _find(canonical_name(type, "srv"), _ACTION_SERVICES)


async def loaded(find: Callable[[str], Any], type: str) -> Any:
    """Return ``find(type)`` after loading its C library in a thread: the first time takes some tens of milliseconds.

    Raises what ``find`` raises, and ``UnknownType`` where the library cannot be loaded.
    """
    return await asyncio.to_thread(_load, find, type)


def _load(find: Callable[[str], Any], type: str) -> Any:
    found = find(type)
    if getattr(found.__class__, "_TYPE_SUPPORT", None) is None:
        try:
            found.__class__.__import_type_support__()
        except (ImportError, AttributeError, RuntimeError) as error:
            raise UnknownType(type, hint=f"the installed package does not load: {error}") from error
    return found


def _find(type: str, action_parts: dict[str, str]) -> Any:
    package, kind, name = type.split("/")
    try:
        module = importlib.import_module(f"{package}.{kind}")
    except ImportError as error:
        raise UnknownType(type, hint=_hint(package, error)) from error
    if kind == "action":
        for suffix, part in action_parts.items():
            whole = getattr(module, name.removesuffix(suffix), None) if name.endswith(suffix) else None
            if whole is not None:
                return getattr(whole.Impl, part)
    found = getattr(module, name, None)
    if found is None:
        raise UnknownType(type, hint=f"the installed {package} has no {kind}/{name}; source a workspace that has")
    return found


def _hint(package: str, error: ImportError) -> str:
    if error.name not in (package, None) and not (error.name or "").startswith(f"{package}."):
        return f"{package} does not load: {error}"
    return (
        f"the package {package} is not in the sourced ROS 2; install ros-$ROS_DISTRO-{package.replace('_', '-')}, or "
        "source the workspace that has it, and start ropeway again"
    )
