"""A worker process: runs one slice of a configuration that comes on standard input, until that ends.

Lines of JSON come in: first the order, then questions, ``{"id": 1, "ask": "module:function", "params": {...}}``. Lines
of JSON on standard output tell the supervisor: ``{"ready": true}`` once, then ``{"status": {...}}`` about once a
second, ``{"audit": [...]}`` what the audit log is to have, or ``{"error": "..."}`` before a failed start ends the
process; and for each question ``{"answer": 1, "value": ...}``, or ``"error"`` with its text.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import json
import logging
import signal
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any

from ropeway import aio
from ropeway.audit.files import AuditLine
from ropeway.audit.merging import AuditEntry
from ropeway.audit.note import NO_AUDIT
from ropeway.audit.trail import AuditTrail
from ropeway.errors import ConfigError, ControlRefused, RopewayError
from ropeway.gateway.config.config import parse
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.process.questions import find_question
from ropeway.gateway.process.worker_process import LINE_BYTES
from ropeway.logs import LimitedHandler, line_format
from ropeway.tasks import Chores, describe

__all__ = ["main"]

log = logging.getLogger("ropeway.gateway")

_STATUS_S = 1.0


def _say(message: dict[str, Any]) -> None:
    sys.stdout.write(json.dumps(message) + "\n")
    sys.stdout.flush()


class _ToSupervisor:
    """Hands entries of the audit log to the supervisor, which writes those of all workers."""

    def __init__(self) -> None:
        self._loop = asyncio.get_running_loop()

    def open(self) -> int:
        """See ``AuditSink``."""
        return 0

    def append(self, entries: Sequence[AuditEntry]) -> None:
        """See ``AuditSink``."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            self._loop.call_soon_threadsafe(_say, {"audit": list(entries)})

    def backwards(self, wanted: Callable[[bytes], bool], before: int | None) -> Iterable[AuditLine]:
        """See ``AuditSink``."""
        return ()

    def close(self) -> None:
        """See ``AuditSink``."""


def _reload(gateway: Gateway) -> None:
    try:
        gateway.reload()
    except ConfigError as error:
        log.error("SIGHUP: nothing has changed: %s", error)


async def _listen(gateway: Gateway, stdin: asyncio.StreamReader, chores: Chores) -> None:
    """Answer questions until standard input ends."""
    while line := await stdin.readline():
        message = json.loads(line)
        chores.start(_answer(gateway, message), f"question {message['ask']}")


async def _answer(gateway: Gateway, message: dict[str, Any]) -> None:
    number = message["id"]
    try:
        question = await find_question(message["ask"])
        _say({"answer": number, "value": await question(gateway, message["params"])})
    except ConfigError as error:
        _say({"answer": number, "error": str(error), "problems": error.problems})
    except ControlRefused as error:
        _say({"answer": number, "error": error.text, "status": error.status})
    except Exception as error:  # whoever asks is told, and the worker goes on
        if not isinstance(error, RopewayError):
            log.exception("question %s failed", message["ask"])
        _say({"answer": number, "error": describe(error)})


async def _run(order: dict[str, Any], stdin: asyncio.StreamReader) -> int:
    trail = AuditTrail(_ToSupervisor()) if order.get("audit") else None
    gateway = Gateway(
        parse(order["config"], order.get("source", "")),
        gateway_id=order["gateway_id"],
        node=order["node"],
        reuse_port=order["reuse_port"],
        audit=NO_AUDIT if trail is None else trail,
    )
    try:
        async with gateway:
            asyncio.get_running_loop().add_signal_handler(signal.SIGHUP, _reload, gateway)
            _say({"ready": True})
            gc.freeze()  # as ``ropeway run`` does
            chores = Chores()
            gone = asyncio.create_task(_listen(gateway, stdin, chores))
            while not gone.done():
                _say({"status": gateway.status()})
                await asyncio.wait([gone], timeout=_STATUS_S)
            await chores.close()
            await gone
    except RopewayError as error:
        _say({"error": str(error)})
        return 1
    finally:
        if trail is not None:
            await asyncio.to_thread(trail.close)
            await asyncio.sleep(0)  # what it handed over last is said
    return 0


async def _main() -> int:
    reader = asyncio.StreamReader(limit=LINE_BYTES)
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    line = await reader.readline()
    if not line:
        return 0  # a spare that was never needed
    order = json.loads(line)
    handler = LimitedHandler(sys.stderr)
    handler.setFormatter(line_format(f" [{order['node']}]".replace("%", "%%")))
    logging.basicConfig(level=order.get("log_level", "INFO"), handlers=[handler])
    return await _run(order, reader)


def main() -> int:
    """Run the worker process."""
    import uvloop

    signal.signal(signal.SIGHUP, signal.SIG_IGN)  # until there is something to read again
    with (
        contextlib.suppress(KeyboardInterrupt, BrokenPipeError),
        aio.Runner(loop_factory=uvloop.new_event_loop) as runner,
    ):
        return runner.run(_main())
    return 0


if __name__ == "__main__":
    sys.exit(main())
