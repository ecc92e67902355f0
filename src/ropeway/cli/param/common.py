"""Provides what the verbs on parameters share: options, values as text, and sentences for failures."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from typing import Annotated, Any, Final, TypeVar

import typer

from ropeway.cli.asking_node import ask_node
from ropeway.cli.session import OpenGraph
from ropeway.errors import ValueMismatch
from ropeway.graph.parameters import ParameterType, ParameterValue, type_of

__all__ = ["NameArgument", "NodeArgument", "TimeoutOption", "ask", "plain", "value_text"]

NodeArgument = Annotated[str, typer.Argument(help="The node, such as /talker.", show_default=False)]
NameArgument = Annotated[str, typer.Argument(help="The parameter, such as use_sim_time.", show_default=False)]
TimeoutOption = Annotated[float, typer.Option("--timeout", min=0.001, help="Seconds to wait for the node.")]

T = TypeVar("T")

_TITLES: Final = {
    ParameterType.BOOL: "Boolean value is:",
    ParameterType.INTEGER: "Integer value is:",
    ParameterType.DOUBLE: "Double value is:",
    ParameterType.STRING: "String value is:",
    ParameterType.BYTE_ARRAY: "Byte values are:",
    ParameterType.BOOL_ARRAY: "Boolean values are:",
    ParameterType.INTEGER_ARRAY: "Integer values are:",
    ParameterType.DOUBLE_ARRAY: "Double values are:",
    ParameterType.STRING_ARRAY: "String values are:",
}


def ask(graph: str, node: str, timeout_s: float, work: Callable[[OpenGraph], Coroutine[Any, Any, T]]) -> T:
    """Run ``work`` on the graph at the URL; a node that does not answer ends with a sentence."""
    return ask_node(graph, node, timeout_s, work, lacking="has no parameter services", listing="param list")


def plain(value: ParameterValue) -> Any:
    """Return the value as JSON and YAML can hold it: bytes as numbers."""
    return list(value) if isinstance(value, bytes) else value


def value_text(value: ParameterValue, *, hide_type: bool = False) -> str:
    """Return the value as ``ros2 param get`` shows it."""
    if value is None:
        return "Parameter not set."
    try:
        title = _TITLES[type_of(value)]
    except ValueMismatch:  # of a master of ROS 1
        title = "Values are:"
    return str(plain(value)) if hide_type else f"{title} {plain(value)}"
