"""TLS handshakes that fail: clients' faults, which the event loop is told of as if they were ours."""

from __future__ import annotations

import asyncio
import ssl
from collections.abc import Callable
from typing import Any

from ropeway.fault_log import FaultLog

__all__ = ["explain_handshake", "watch_handshakes"]


class _Handler:
    """The exception handler of a loop while TLS listeners are open on it; all else goes to the one that was there."""

    def __init__(self, others: Callable[[asyncio.AbstractEventLoop, dict[str, Any]], object] | None) -> None:
        self.others = others
        self.listeners: dict[FaultLog, int] = {}  # with the port of each

    def __call__(self, loop: asyncio.AbstractEventLoop, context: dict[str, Any]) -> None:
        """Tell the listener, or the handler that was there before."""
        if context.get("message") == "SSL handshake failed" and self.listeners:
            error = context.get("exception")
            text = explain_handshake(error)
            self._listener(context.get("transport")).note("handshake", "", text)
        elif self.others is not None:
            self.others(loop, context)
        else:
            loop.default_exception_handler(context)

    def _listener(self, transport: Any) -> FaultLog:
        name = transport.get_extra_info("sockname") if transport is not None else None
        port = name[1] if isinstance(name, tuple) else 0
        found = (fault_log for fault_log, known in self.listeners.items() if known == port)
        return next(found, next(iter(self.listeners)))


def watch_handshakes(fault_log: FaultLog, port: int) -> Callable[[], None]:
    """Note handshakes that fail on ``port`` in ``fault_log``; return the function that ends this.

    With the last listener of a loop its exception handler is what it was before.
    """
    loop = asyncio.get_running_loop()
    handler = loop.get_exception_handler()
    if not isinstance(handler, _Handler):
        handler = _Handler(handler)
        loop.set_exception_handler(handler)
    handler.listeners[fault_log] = port

    def end() -> None:
        handler.listeners.pop(fault_log, None)
        if not handler.listeners and loop.get_exception_handler() is handler:
            loop.set_exception_handler(handler.others)

    return end


def explain_handshake(error: object) -> str:
    """Explain why a handshake failed, for whoever has to fix the client."""
    reason = error.reason if isinstance(error, ssl.SSLError) else ""
    if reason in ("HTTP_REQUEST", "WRONG_VERSION_NUMBER"):
        return "a client speaks ws:// or http:// without TLS, and this listener wss:// or iorts://"
    if reason == "PEER_DID_NOT_RETURN_A_CERTIFICATE":
        return "a client showed no certificate, and tls.ca asks for one"
    kind = error if isinstance(error, type) else type(error)
    if issubclass(kind, ConnectionError):
        return "a client left before TLS was agreed upon: it does not trust the certificate, or speaks something else"
    return str(error) or kind.__name__
