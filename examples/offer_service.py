"""Offer a service until Ctrl-C: python examples/offer_service.py [dds:0]."""

import asyncio
import sys

import ropeway


async def add(request: ropeway.TypedMessage) -> dict[str, int]:
    """Answer a request; what is raised here, the caller gets as an error."""
    print(f"adding {request['a']} and {request['b']}", flush=True)
    return {"sum": request["a"] + request["b"]}


async def main(url: str = "dds:0") -> None:
    """Serve calls, any number at a time."""
    async with ropeway.open(url, name="adder") as graph, graph.serve("/add", "example_interfaces/AddTwoInts", add):
        print("serving /add", flush=True)
        await asyncio.Event().wait()


asyncio.run(main(*sys.argv[1:]))
