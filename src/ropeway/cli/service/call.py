"""``ropeway service call``: call a service, once or at a rate."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Annotated, Any

import orjson
import typer

from ropeway.cli.console import answer, fail, print_json
from ropeway.cli.loop import run
from ropeway.cli.patience import patiently, served_within
from ropeway.cli.service.info import ServiceArgument
from ropeway.cli.session import GraphOption, JsonOption, OpenGraph, TypesOption, full_name, open_session
from ropeway.cli.topic.render import Style, as_python
from ropeway.cli.values import fitted, typed_values
from ropeway.errors import CallTimeout, NotServed
from ropeway.graph.calls import Client, Request
from ropeway.types.definition import canonical_name

__all__ = ["app", "call"]

app = typer.Typer(add_completion=False)


async def call(
    session: OpenGraph,
    service: str,
    type: str,
    values: dict[str, Any],
    *,
    timeout_s: float,
    rate_hz: float | None = None,
    asking: Callable[[bytes], None] = lambda request: None,
    told: Callable[[bytes], None] = lambda response: None,
) -> None:
    """Call once, or at ``rate_hz`` for ever; ``asking`` and ``told`` get the CDR of requests and responses.

    Each call waits ``timeout_s``; a response that has not come at the time of the next call delays it. Raises
    ``ValueMismatch`` for values that do not fit, before anything is sent, and ``CallError``.
    """
    full = canonical_name(type, "srv")
    codec = session.registry.codec(f"{full}_Request")
    values = fitted(session.registry, codec.type, values)
    client = await session.graph.create_client(service, full)
    try:
        loop = asyncio.get_running_loop()
        due = loop.time()
        while True:
            await _call_once(client, codec.from_json(values), timeout_s, asking, told)
            if rate_hz is None:
                return
            due = max(due + 1.0 / rate_hz, loop.time())
            await asyncio.sleep(due - loop.time())
    finally:
        await client.close()


async def _call_once(
    client: Client, payload: bytes, timeout_s: float, asking: Callable[[bytes], None], told: Callable[[bytes], None]
) -> None:
    asking(payload)

    def waiting_for() -> str:
        if client.available:
            return f"waiting for the response of {client.service} ({timeout_s:g} s at most)"
        return f"waiting for {client.service} to become available ({timeout_s:g} s at most)"

    async with patiently(waiting_for):
        left_s = await served_within(client, timeout_s)
        response = await client.call(Request(payload, caller="ropeway service call"), left_s)
    told(response)


@app.command("call")
def call_command(
    service: ServiceArgument,
    type: Annotated[str, typer.Argument(help="Its type, such as std_srvs/srv/SetBool.", show_default=False)],
    values: Annotated[str, typer.Argument(help="The request in YAML or JSON, such as '{data: true}'.")] = "{}",
    graph: GraphOption = "",
    stdin: Annotated[bool, typer.Option("--stdin", help="Read the values from standard input.")] = False,
    rate: Annotated[
        float | None, typer.Option("--rate", "-r", min=1e-6, help="Calls per second.", show_default=False)
    ] = None,
    timeout: Annotated[float, typer.Option("--timeout", min=0.001, help="Seconds to wait for a response.")] = 5.0,
    types: TypesOption = None,
    as_json: JsonOption = False,
) -> None:
    """Call SERVICE and print its response."""
    name = full_name(service)
    fields = typed_values(values, stdin=stdin)

    async def main() -> None:
        async with open_session(graph, types) as session:
            registry = session.registry
            full = canonical_name(type, "srv")
            await session.know(full)
            ask, read = registry.codec(f"{full}_Request"), registry.codec(f"{full}_Response")

            def asking(request: bytes) -> None:
                if not as_json:
                    text = as_python(registry, ask.type, ask.decode(request), Style())
                    answer(f"requester: making request: {text}\n")

            def told(response: bytes) -> None:
                if as_json:
                    print_json({"service": name, "type": full, "response": orjson.Fragment(read.json(response))})
                else:
                    text = as_python(registry, read.type, read.decode(response), Style(truncate=None))
                    answer(f"response:\n{text}\n")

            await call(session, name, full, fields, timeout_s=timeout, rate_hz=rate, asking=asking, told=told)

    try:
        run(main())
    except NotServed:
        fail(f"nobody serves {name} within {timeout:g} s; see `ropeway service list`, or wait longer with --timeout")
    except CallTimeout:
        fail(f"{name} gave no response within {timeout:g} s; wait longer with --timeout")
