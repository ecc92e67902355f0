"""What a node of rmw_zenoh_cpp 0.2.10 (Jazzy) put on its network, recorded in domain 9.

Tokens stand there as they came; messages, requests and answers with their keys, and their bytes in hexadecimal.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

__all__ = ["ANSWERS", "MESSAGES", "REQUESTS", "TOKENS"]

_RECORDED: Final[dict[str, Any]] = json.loads(Path(__file__).with_name("genuine_jazzy.json").read_text())
TOKENS: Final[list[str]] = _RECORDED["tokens"]
MESSAGES: Final[list[dict[str, str]]] = _RECORDED["messages"]
REQUESTS: Final[list[dict[str, str]]] = _RECORDED["requests"]
ANSWERS: Final[list[dict[str, str]]] = _RECORDED["answers"]
