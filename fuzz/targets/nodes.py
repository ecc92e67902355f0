"""What robots that know no ROS send, and the files in which values are kept."""

from __future__ import annotations

import asyncio
import json
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, Final

from fuzz.target import Target
from fuzz.targets.nested import NESTED_JSON
from ropeway.iort import AsyncNode, Fault, Packet, Parser, _Connection
from ropeway.store.entry import Entry, as_json
from ropeway.store.files import FilesBackend

__all__ = ["TARGETS"]

_LARGEST_BYTES: Final = 256
_SEEDS: Final = (
    b"%01/PEPPER/cmd_vel/p/1,0,0,0,0,2%%01/A/b/s%",
    b"%01/SYSTEM/KIND/TOPIC/p/x%%01/S/T/e/why%",
    b"%01/NAME/-/+hello/n=1,v=1,token=a~2b%%01/S/T/+pub/n=2,t=1,v=2/da~1ta%%01/S/T/+sub/n=4,last=1%",
)


def _packets(data: bytes) -> None:
    """However a stream is cut, the same packets come of it, and what is read can be written and read again."""
    step = 1 + data[0] % 7 if data else 1
    stream = data[1:]
    whole = Parser(_LARGEST_BYTES).feed(stream)
    cut, found = Parser(_LARGEST_BYTES), []
    for at in range(0, len(stream), step):
        found += cut.feed(stream[at : at + step])
    assert list(map(repr, whole)) == list(map(repr, found))
    for item in whole:
        if isinstance(item, Packet):
            again = [each for each in Parser().feed(item.encode()) if not isinstance(each, Fault)]
            assert again == [item], (item, again)


def _answers(data: bytes) -> None:
    """What a server tells a node: what it subscribed, and the answers to what it asked."""
    loop = asyncio.new_event_loop()
    try:
        loop.run_until_complete(_hear(data))
    finally:
        loop.close()


async def _hear(data: bytes) -> None:
    node = AsyncNode("S", "iort://127.0.0.1:1")
    await node.subscribe("*", lambda value: (value.text, value.age_s), system="*")
    connection = _Connection(node, "iort://127.0.0.1:1", "remote", _LARGEST_BYTES)
    connection.data_received(data)
    assert all(isinstance(value.version, int) for value in node._copy.values.values())


def _value(**more: Any) -> bytes:
    return json.dumps(as_json(Entry("S", "t", b"x", 5, 6, "o", "", "")) | more).encode()


def _node(data: bytes) -> None:
    """A node's own copy, damaged."""
    with TemporaryDirectory(prefix="fuzz-") as folder:
        (Path(folder) / "S").mkdir()
        (Path(folder) / "S" / "t.json").write_bytes(data)
        AsyncNode("S", "iort://127.0.0.1:1", directory=folder)


def _store(data: bytes) -> None:
    """A store of files, damaged."""
    with TemporaryDirectory(prefix="fuzz-") as folder:
        (Path(folder) / "S").mkdir()
        (Path(folder) / "S" / "t.json").write_bytes(data)
        backend = FilesBackend(folder)
        backend.open()
        for entry in backend.load():
            assert isinstance(entry.data, bytes)
            assert isinstance(entry.order[0], int)
        backend.close()


TARGETS: Final = {
    "node-packets": Target(
        _packets,
        (),
        lambda: [b"\3" + seed for seed in _SEEDS],
        (b"%", b"/", b"~0", b"~2", b"/+pub/n=", b"/p/", b"/s%", b"\xff"),
    ),
    "node-answers": Target(
        _answers,
        (),
        lambda: [b"%01/S/T/+val/v=5,t=6,o=a,k=b,last=1/1,2%%01/-/-/+evt/n=1%"],
        (b"v=", b"t=", b"\xc2\xb2", b"9" * 20),
    ),
    "node-files": Target(
        _node,
        (),
        lambda: [_value(unsent=[json.loads(_value())]), _value(base64="eA=="), *NESTED_JSON],
        (b"null", b"1e999"),
    ),
    "store-files": Target(
        _store, (), lambda: [_value(), _value(base64="eA=="), *NESTED_JSON], (b"null", b"1e999", b"9" * 400)
    ),
}
