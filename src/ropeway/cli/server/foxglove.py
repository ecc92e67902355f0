"""foxglove_bridge's parameters, for ``ropeway server --foxglove``."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Final

from ropeway.errors import ConfigError
from ropeway.gateway.config.yaml_text import read_yaml

__all__ = ["FOXGLOVE_NODE", "FOXGLOVE_PORT", "LISTS", "UNUSED", "foxglove_settings"]

FOXGLOVE_NODE: Final = "foxglove_bridge"
"""The name of foxglove_bridge's node, and of ours in its place."""

FOXGLOVE_PORT: Final = 8765

LISTS: Final = (
    *("topic_whitelist", "service_whitelist", "param_whitelist", "client_topic_whitelist"),
    *("best_effort_qos_topic_whitelist", "capabilities", "asset_uri_allowlist"),
)
"""The parameters that are lists of texts."""

UNUSED: Final[Mapping[str, str]] = {
    "debug": "--log-level debug tells more",
    "disable_load_message": "messages are passed on as they are",
    "disable_loan_message": "messages are passed on as they are",
    "ignore_unresponsive_param_nodes": "a node that does not answer holds nobody up",
    "num_threads": "there is one event loop",
    "message_backlog_size": "queues are bounded in bytes, and the newest message of a topic goes first",
    "publish_client_count": "viewers are shown by ropeway status",
    "sysinfo": "ropeway status and the control API tell how the server is",
    "sysinfo_topic": "ropeway status and the control API tell how the server is",
    "sysinfo_refresh_interval": "ropeway status and the control API tell how the server is",
}
"""The parameters that mean nothing here, each with its reason."""

_PLAIN: Final = ("min_qos_depth", "max_qos_depth", "send_buffer_limit", "use_sim_time", "include_hidden")


def foxglove_settings(given: Mapping[str, Any]) -> dict[str, Any]:
    """Return ``gateway.foxglove`` for the options ``given``. Raises ``ConfigError`` for a list that is none.

    Files are served where ``asset_roots`` are named; where only patterns are, from the sourced ROS 2.
    """
    found: dict[str, Any] = {name: given[name] for name in _PLAIN if given[name] is not None}
    for name in LISTS:
        if given[name]:
            found[name] = _listed(name, given[name])
    roots = [str(path.absolute()) for path in given["asset_roots"] or ()]
    if not roots and "asset_uri_allowlist" in found:
        prefixes = os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep)
        roots = [share for prefix in prefixes if prefix and Path(share := f"{prefix}/share").is_dir()]
    if roots:
        found["asset_roots"] = roots
    return found


def _listed(name: str, text: str) -> list[str]:
    """Return a list as ROS writes it, ``['/a','/b.*']``, or a single text."""
    value = read_yaml(text, name) if text.lstrip().startswith("[") else [text]
    if not isinstance(value, list) or not all(isinstance(item, str) for item in value):
        raise ConfigError(
            [(name, f"expected a list of texts, as in ['/a','/b.*'], got {text[:100]}")], "ropeway server"
        )
    return [item for item in value if item]
