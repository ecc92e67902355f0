"""Call a service: python examples/call_service.py 1 2 [dds:0]."""

import sys

import ropeway
from ropeway import blocking

a, b, url = int(sys.argv[1]), int(sys.argv[2]), (sys.argv[3:] or ["dds:0"])[0]
with blocking.open(url) as graph:
    try:
        response = graph.call("/add", {"a": a, "b": b}, "example_interfaces/AddTwoInts")
    except ropeway.NotServed:
        sys.exit(f"nobody serves /add on {url}; run examples/offer_service.py")
    except ropeway.CallError as error:
        sys.exit(f"/add gave no answer: {error}")
    print(response["sum"])
