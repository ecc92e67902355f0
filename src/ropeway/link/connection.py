"""One WebSocket connection, either role, over picows: the only module that touches sockets.

A ``Connection`` delivers whole messages (continuation frames joined, bounded), tells when it can take more
(``writable``), notices a dead peer, and closes with a code and a reason. What the bytes mean is not its concern.
"""

from __future__ import annotations

import asyncio
import contextlib
import logging
import os
import socket
import ssl
import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final
from urllib.parse import urlsplit

import picows
from picows import WSCloseCode, WSFrame, WSListener, WSMsgType, WSTransport

from ropeway.errors import ConnectFailed
from ropeway.link.complaints import Complaints
from ropeway.link.pace import Pace
from ropeway.link.window import Window, tcp_info

__all__ = ["Connection", "Handshake", "Limits", "Server", "connect", "listen"]

log = logging.getLogger("ropeway.link")


class _PicowsLog(logging.LoggerAdapter[logging.Logger]):
    """Leaves to us what a peer did wrong: we know its address."""

    def error(self, msg: object, *args: object, **kwargs: Any) -> None:
        if not str(msg).startswith("WS parser error"):
            super().error(msg, *args, **kwargs)


logging.getLogger("ropeway.link.picows").setLevel(logging.ERROR)
_picows_log = _PicowsLog(logging.getLogger("ropeway.link.picows"), {})

_TCP_RTO_MAX_MS: Final = 44  # Linux 6.15
_RETRANSMIT_MS: Final = 1000  # what was lost is sent again so often at least, and goes soon after a cut has ended
_OTHER_HOST: Final = (62, 64)  # OpenSSL: X509_V_ERR_HOSTNAME_MISMATCH, X509_V_ERR_IP_ADDRESS_MISMATCH
_EXPIRED: Final = 10
_SHORTEST_LOOK_S: Final = 0.001
_LONGEST_LOOK_S: Final = 0.05
_ALMOST_NOTHING_BYTES: Final = 3000  # two segments, which a receiver may acknowledge late
_LATE: Final = 0.3  # of the time: a look that came so late says nothing of the link
_LATE_LOOKS: Final = 3  # in a row: then more must be on the way while we do other things
_FASTER: Final = 1.25  # a wider window that brings so much more shows that the link has room


@dataclass(frozen=True, slots=True)
class Limits:
    """Bounds of a connection.

    ``max_message_bytes``: inbound; more closes with 1009 (64 MiB carries a 60 MB point cloud).
    ``ping_interval_s``: a ping is sent this long after the last one; ``silence_s``: the peer is given up after so
    long without a byte (the two defaults notice a cut within 5 s). ``None`` turns the watch off.
    """

    max_message_bytes: int = 64 << 20
    ping_interval_s: float | None = 1.0
    silence_s: float | None = 4.0
    open_timeout_s: float = 5.0


@dataclass(frozen=True, slots=True)
class Handshake:
    """What the client asked for when it connected."""

    path: str
    query: str
    headers: Mapping[str, str]
    subprotocols: tuple[str, ...]


class Connection(WSListener):
    """A WebSocket connection.

    Set ``on_text``, ``on_binary``, ``on_writable`` and ``on_closed`` before the first await after it was made.
    ``peer`` is the address of the other side, ``subprotocol`` what both agreed on.
    """

    def __init__(self, limits: Limits, *, peer: str = "") -> None:
        self.limits = limits
        self.silence_s = limits.silence_s
        self.peer = peer
        self.subprotocol = ""
        self.pace = Pace()
        self.on_connected: Callable[[], None] = _nothing
        self.on_text: Callable[[bytes], None] = _ignore
        self.on_binary: Callable[[bytes | memoryview], None] = _ignore
        self.on_writable: Callable[[], None] = _nothing
        self.on_closed: Callable[[int, str], None] = _ignore_close
        self.bytes_in = self.bytes_out = self.frames_in = self.frames_out = 0
        self.connected_at = time.time()
        self.writable = False
        self.secure = False
        self.handshake: Handshake | None = None
        self._transport: WSTransport | None = None
        self._socket: Any = None
        self._unfinished: bytearray | None = None  # a message in continuation frames, as far as it came
        self._unfinished_text = False
        self._pong: bytes | None = None  # the answer to the last ping, which waits until the link takes it
        self._last_heard = time.monotonic()
        self._heard_bytes = 0
        self._watch: asyncio.Task[None] | None = None
        self._close_code, self._close_reason = 1006, "the connection was lost"
        self._closed = asyncio.Event()
        self.window: Window | None = None
        self._full_at: float | None = None  # since when the operating system takes no more
        self._full_bytes = 0
        self._waits_since: float | None = None  # since when the window is used up
        self._waits_bytes = 0
        self._look_due = 0.0
        self._late_looks = 0
        self._rate_when_empty = 0.0
        self._look: asyncio.TimerHandle | None = None
        self._closing: asyncio.TimerHandle | None = None

    # ── sending ────────────────────────────────────────────────────────────────────────────────────────────────

    def send_text(self, data: bytes | str) -> None:
        """Send a text frame now; look at ``writable`` first for anything that can wait."""
        self._send(WSMsgType.TEXT, data)

    def send_binary(self, data: bytes | bytearray | memoryview) -> None:
        """Send a binary frame now; look at ``writable`` first for anything that can wait."""
        self._send(WSMsgType.BINARY, data)

    def _send(self, kind: Any, data: Any) -> None:
        transport = self._transport
        if transport is None or self._closed.is_set():
            return
        size = len(data)
        self.bytes_out += size
        self.frames_out += 1
        transport.send(kind, data)
        window = self.window
        if self.writable and window is not None and window.limit is not None:
            outstanding = window.outstanding()
            if outstanding is not None and outstanding >= window.limit:
                self._wait_for_window(outstanding)

    # ── when to send ───────────────────────────────────────────────────────────────────────────────────────────

    def _wait_for_window(self, outstanding: int) -> None:
        self.writable = False
        self._waits_since, self._waits_bytes = time.monotonic(), outstanding
        self._arm(outstanding)

    def _arm(self, outstanding: int) -> None:
        window = self.window
        assert window is not None
        pace = self.pace.bytes_per_s
        enough = (window.limit or 0) // 2
        seconds = _SHORTEST_LOOK_S if pace is None else min((outstanding - enough) / pace, _LONGEST_LOOK_S)
        loop = asyncio.get_running_loop()
        self._look_due = loop.time() + max(seconds, _SHORTEST_LOOK_S)
        self._look = loop.call_at(self._look_due, self._look_again)

    def _look_again(self) -> None:
        self._look = None
        window, since = self.window, self._waits_since
        if window is None or since is None or self._closed.is_set():
            return
        outstanding = window.outstanding() or 0
        if window.limit is not None and outstanding > window.limit // 2:
            self._arm(outstanding)
            return
        self._waits_since = None
        seconds = time.monotonic() - since
        late_s = asyncio.get_running_loop().time() - self._look_due
        self._learn(self._waits_bytes - outstanding, seconds, outstanding, late_s)
        self._go_on()

    def _learn(self, carried_bytes: int, seconds: float, outstanding: int, late_s: float = 0.0) -> None:
        """Take the measure of the link, if it was busy all the time until we looked."""
        window, pace = self.window, self.pace
        if window is None or seconds <= 0:
            return
        if outstanding <= _ALMOST_NOTHING_BYTES:
            rate, before = carried_bytes / seconds, self._rate_when_empty
            self._rate_when_empty = rate
            late = late_s > _LATE * seconds
            self._late_looks = self._late_looks + 1 if late else 0
            if (late and self._late_looks >= _LATE_LOOKS) or (pace.bytes_per_s is None and rate > _FASTER * before):
                window.grow()
                return
            if late:
                return
        pace.carried(carried_bytes, seconds)
        if pace.bytes_per_s is not None:
            window.fit(pace.bytes_per_s)

    def _go_on(self) -> None:
        if self._full_at is None and self._waits_since is None and self._closing is None and not self.closed:
            self.writable = True
            if self._pong is not None:
                ping, self._pong = self._pong, None
                self._answer(ping)
            if self.writable:
                self.on_writable()

    @property
    def unsent_bytes(self) -> int:
        """What the operating system has not taken yet."""
        transport = self._transport
        if transport is None:
            return 0
        return int(transport.underlying_transport.get_write_buffer_size())

    def pause_reading(self) -> None:
        """Take no more from the peer for now; the operating system's window then holds it back."""
        if self._transport is not None and not self._closed.is_set():
            self._transport.underlying_transport.pause_reading()

    def resume_reading(self) -> None:
        """Take from the peer again."""
        if self._transport is not None and not self._closed.is_set():
            self._transport.underlying_transport.resume_reading()

    def close(self, code: int = 1000, reason: str = "") -> None:
        """Start the closing handshake; the transport goes within a second whatever the peer does."""
        transport = self._transport
        if transport is None or self._closing is not None or self._closed.is_set():
            return
        self._close_code, self._close_reason = code, reason
        self.writable = False
        try:
            close_code = WSCloseCode(code)
        except ValueError:
            close_code = WSCloseCode.OK
        transport.send_close(close_code, reason.encode("ascii", "replace")[:120])
        self._closing = asyncio.get_running_loop().call_later(1.0, transport.disconnect, False)

    def abort(self, reason: str) -> None:
        """Drop the connection without a word to the peer."""
        self._close_code, self._close_reason = 1006, reason
        if self._transport is not None:
            self._transport.disconnect(False)

    async def wait_closed(self) -> tuple[int, str]:
        """Wait for the end; gives the close code and the reason."""
        await self._closed.wait()
        return self._close_code, self._close_reason

    @property
    def closed(self) -> bool:
        """True once nothing can be sent or received."""
        return self._closed.is_set()

    # ── picows callbacks ───────────────────────────────────────────────────────────────────────────────────────

    def on_ws_connected(self, transport: WSTransport) -> None:
        """Called by picows after the handshake."""
        self._transport = transport
        underlying = transport.underlying_transport
        underlying.set_write_buffer_limits(high=0, low=0)
        self._socket = underlying.get_extra_info("socket")
        with contextlib.suppress(OSError, AttributeError):
            self._socket.setsockopt(socket.IPPROTO_TCP, _TCP_RTO_MAX_MS, _RETRANSMIT_MS)
        self.secure = underlying.get_extra_info("sslcontext") is not None
        if not self.peer:
            self.peer = _address(underlying.get_extra_info("peername"))
        if transport.response is not None:
            self.subprotocol = transport.response.headers.get("Sec-WebSocket-Protocol", "")  # the client's side
        self.window = Window(self._socket)
        self.writable = True
        self._last_heard = time.monotonic()
        if self.limits.ping_interval_s is not None:
            self._watch = asyncio.get_running_loop().create_task(self._watch_peer(), name=f"watch {self.peer}")
        self.on_connected()

    def on_ws_frame(self, transport: WSTransport, frame: WSFrame) -> None:
        """Called by picows for every frame."""
        kind = frame.msg_type
        self._last_heard = time.monotonic()
        size = frame.payload_size
        self.bytes_in += size
        if kind == WSMsgType.BINARY or kind == WSMsgType.TEXT:
            if self._closing is not None:
                return
            if self._unfinished is not None:
                self._fail(1002, "a new message began before the last one ended")
            elif frame.fin:
                self.frames_in += 1
                if kind == WSMsgType.BINARY:
                    self.on_binary(frame.get_payload_as_memoryview())
                else:
                    self.on_text(frame.get_payload_as_bytes())
            else:
                self._unfinished = bytearray(frame.get_payload_as_memoryview())
                self._unfinished_text = kind == WSMsgType.TEXT
        elif kind == WSMsgType.CONTINUATION:
            if self._closing is None:
                self._continue(frame)
        elif kind == WSMsgType.PING:
            self._answer(frame.get_payload_as_bytes())
        elif kind == WSMsgType.CLOSE:
            code = frame.get_close_code()
            if self._closing is None:
                self._close_code = _number(code) or 1005
                self._close_reason = (
                    frame.get_close_message().decode(errors="replace") if frame.payload_size > 2 else ""
                )
            transport.send_close(code if _number(code) else WSCloseCode.OK)
            transport.disconnect()

    def _continue(self, frame: WSFrame) -> None:
        message = self._unfinished
        if message is None:
            self._fail(1002, "a continuation came without a beginning")
            return
        if len(message) + frame.payload_size > self.limits.max_message_bytes:
            self._fail(1009, f"a message may have {self.limits.max_message_bytes} bytes at most")
            return
        message += frame.get_payload_as_memoryview()
        if frame.fin:
            self.frames_in += 1
            self._unfinished = None
            data = bytes(message)
            if self._unfinished_text:
                self.on_text(data)
            else:
                self.on_binary(data)

    def _answer(self, ping: bytes) -> None:
        if self.writable:
            assert self._transport is not None
            self._transport.send_pong(ping)
        else:
            self._pong = ping  # only the last one needs an answer, and a peer that does not read gets no more

    def on_ws_disconnected(self, transport: WSTransport) -> None:
        """Called by picows when the transport is gone."""
        self.writable = False
        if self._look is not None:
            self._look.cancel()
        handshake = transport.close_handshake
        if handshake is not None and handshake.sent is not None and self._close_code == 1006:
            sent = handshake.sent
            self._close_code = _number(sent.code)
            self._close_reason = sent.reason or self._close_reason
            log.warning("%s: closed: %s", self.peer, self._close_reason)
        if self._closing is not None:
            self._closing.cancel()
        if self._watch is not None and self._watch is not asyncio.current_task():
            self._watch.cancel()
        if not self._closed.is_set():
            self._closed.set()
            self.on_closed(self._close_code, self._close_reason)

    def pause_writing(self) -> None:
        """Called by the transport when it holds bytes that the operating system did not take."""
        self.writable = False
        self._full_at, self._full_bytes = time.monotonic(), self.unsent_bytes

    def resume_writing(self) -> None:
        """Called by the transport when the operating system took everything."""
        since, self._full_at = self._full_at, None
        if since is not None and self._waits_since is None and self.window is not None:
            self._learn(self._full_bytes, time.monotonic() - since, self.window.outstanding() or 0)
        self._go_on()

    def _fail(self, code: int, reason: str) -> None:
        self._unfinished = None
        log.warning("%s: closed: %s", self.peer, reason)
        self.close(code, reason)

    # ── the watch ──────────────────────────────────────────────────────────────────────────────────────────────

    async def _watch_peer(self) -> None:
        interval = self.limits.ping_interval_s
        assert interval is not None
        while self._transport is not None and not self._closed.is_set():
            self._transport.send_ping()
            await asyncio.sleep(interval)
            silence = self.silence_s
            if silence is None:
                continue
            received = self._received_bytes()
            if received != self._heard_bytes:  # part of a message counts as a sign of life
                self._heard_bytes = received
                self._last_heard = time.monotonic()
            if time.monotonic() - self._last_heard > silence:
                self.abort(f"nothing was heard for {silence:g} s")
                return

    def _received_bytes(self) -> int:
        info = tcp_info(self._socket)
        return info.bytes_received if info is not None else 0


def _take_failed_handshakes(complaints: Complaints) -> None:
    """A client that hangs up during the TLS handshake is told to the event loop as an error of ours: it is none."""
    loop = asyncio.get_running_loop()
    others = loop.get_exception_handler()

    def handle(_: object, context: dict[str, Any]) -> None:
        if context.get("message") == "SSL handshake failed":
            error = context.get("exception")
            complaints.note("handshake", "", str(error) or getattr(error, "__name__", error))
        elif others is not None:
            others(loop, context)
        else:
            loop.default_exception_handler(context)

    loop.set_exception_handler(handle)


def _ignore(_: object) -> None:
    return None


def _ignore_close(_code: int, _reason: str) -> None:
    return None


def _nothing() -> None:
    return None


def _number(code: Any) -> int:
    return int(getattr(code, "value", code))


def _distrust(error: ssl.SSLCertVerificationError) -> str:
    if error.verify_code in _OTHER_HOST:
        return f"its certificate is not for this host ({error.verify_message})"
    if error.verify_code == _EXPIRED:
        return "its certificate has expired"
    return f"its certificate is not trusted ({error.verify_message}); name its CA under tls.ca"


def _reason(error: OSError) -> str:
    """What the operating system says, without the words of the event loop around it."""
    if isinstance(error, (socket.gaierror, ssl.SSLError)) or not error.errno:
        return error.strerror or str(error)
    return os.strerror(error.errno)


def _address(name: Any) -> str:
    if isinstance(name, tuple) and len(name) >= 2:
        return f"[{name[0]}]:{name[1]}" if ":" in str(name[0]) else f"{name[0]}:{name[1]}"
    return str(name or "unknown")


async def connect(
    url: str,
    *,
    limits: Limits,
    subprotocols: Sequence[str] = (),
    ssl_context: ssl.SSLContext | None = None,
    headers: Mapping[str, str] | None = None,
    on_connection: Callable[[Connection], None] | None = None,
) -> Connection:
    """Connect to a ``ws://`` or ``wss://`` URL.

    ``on_connection`` is called before the first message: what the server says at once is lost without.
    Raises ``ConnectFailed``; its ``retryable`` is false for answers that another try will not change.
    """
    connection = Connection(limits, peer=url)
    if on_connection is not None:
        connection.on_connected = lambda: on_connection(connection)
    extra = dict(headers or {})
    if subprotocols:
        extra["Sec-WebSocket-Protocol"] = ", ".join(subprotocols)
    try:
        async with asyncio.timeout(limits.open_timeout_s):
            await picows.ws_connect(
                lambda: connection,
                url,
                ssl_context=ssl_context,
                websocket_handshake_timeout=limits.open_timeout_s,
                max_frame_size=limits.max_message_bytes,
                extra_headers=extra,
                logger_name=_picows_log,
                disconnect_on_exception=False,
                enable_auto_pong=False,
            )
    except TimeoutError:
        raise ConnectFailed(url, "no answer in time") from None
    except ssl.SSLCertVerificationError as error:
        raise ConnectFailed(url, _distrust(error), retryable=False) from None
    except picows.WSError as error:
        response = getattr(error, "response", None)
        status = response.status.value if response is not None else None
        fatal = status in (400, 401, 403, 404)
        what = f"answered HTTP {status}" if status else f"is not a WebSocket server ({error})"
        raise ConnectFailed(url, what, retryable=not fatal) from None
    except OSError as error:
        raise ConnectFailed(url, _reason(error)) from None
    if connection.closed or not connection.writable:  # picows takes a server that hangs up for one that answers
        hint = "; does it ask for a certificate that it trusts (tls.certificate)?" if ssl_context is not None else ""
        raise ConnectFailed(url, f"closed the connection during the handshake{hint}")
    return connection


class Server:
    """A listening socket; made by ``listen``."""

    def __init__(self, server: asyncio.AbstractServer, address: str) -> None:
        self._server = server
        self.address = address
        sockets = getattr(server, "sockets", ())
        self.port: int = sockets[0].getsockname()[1] if sockets else 0

    async def close(self) -> None:
        """Stop listening; connections that stand go on."""
        self._server.close()


async def listen(
    host: str,
    port: int,
    on_connection: Callable[[Connection], None],
    *,
    limits: Limits,
    subprotocols: Sequence[str] = (),
    ssl_context: ssl.SSLContext | None = None,
    path: str = "/",
    reuse_port: bool = False,
) -> Server:
    """Listen for WebSocket clients on ``host:port``; ``port`` 0 takes a free one.

    Of the subprotocols that a client offers the first of ours is chosen; a client that offers none gets none.
    Raises ``ConnectFailed`` if the address cannot be bound.
    """

    def upgrade(request: picows.WSUpgradeRequest) -> Any:
        target = urlsplit(request.path.decode("latin-1"))
        if target.path.rstrip("/") != path.rstrip("/"):
            return None
        offered = tuple(
            part.strip() for value in request.headers.getall("Sec-WebSocket-Protocol", []) for part in value.split(",")
        )
        chosen = next((name for name in subprotocols if name in offered), "")
        connection = Connection(limits)
        connection.subprotocol = chosen
        connection.handshake = Handshake(target.path, target.query, request.headers, offered)
        connection.on_connected = lambda: on_connection(connection)
        extra = {"Sec-WebSocket-Protocol": chosen} if chosen else None
        return picows.WSUpgradeResponseWithListener(
            picows.WSUpgradeResponse.create_101_response(extra_headers=extra), connection
        )

    address = f"{'wss' if ssl_context else 'ws'}://{f'[{host}]' if ':' in host else host}:{port}"
    if ssl_context is not None:
        _take_failed_handshakes(Complaints(address))
    try:
        server = await picows.ws_create_server(
            upgrade,
            host,
            port,
            ssl=ssl_context,
            reuse_port=reuse_port or None,
            reuse_address=True,
            max_frame_size=limits.max_message_bytes,
            websocket_handshake_timeout=limits.open_timeout_s,
            logger_name=_picows_log,
            disconnect_on_exception=False,
            enable_auto_pong=False,
        )
    except OSError as error:
        raise ConnectFailed(
            address, f"cannot listen: {error.strerror or error}; is another gateway running?", retryable=False
        ) from None
    return Server(server, address)
