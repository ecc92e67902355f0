"""The helper process: ``python -m ropeway.networks.dds.fastdds.worker FD`` serves the gateway behind the socket ``FD``.

It ends when the gateway closes the socket, or ends itself. Whatever is wrong with it, it may end at any time: the
gateway fails the calls that were under way and starts another.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import threading

from ropeway.errors import GraphUnavailable
from ropeway.networks.dds import raw
from ropeway.networks.dds.fastdds import selfcall
from ropeway.networks.dds.fastdds.frames import BadFrame, HelperFrame, Op, Spec, Splitter, encode
from ropeway.networks.dds.fastdds.identity import GUID_BYTES
from ropeway.networks.dds.fastdds.node import FastNode
from ropeway.networks.dds.fastdds.serdata_hook import HookError
from ropeway.networks.dds.fastdds.service_endpoints import ClientEnd, ServiceEnd
from ropeway.networks.dds.profile import Profile
from ropeway.networks.dds.raw import DdsError

__all__ = ["HelperWorker", "main"]

_RECEIVE_BYTES = 1 << 20
# Where this process is killed, nodes forget it in half the usual time, and take its successor for what it is.
_LIVELY = (
    "<CycloneDDS><Domain><Discovery><LeaseDuration>5s</LeaseDuration><SPDPInterval>1s</SPDPInterval>"
    "</Discovery></Domain></CycloneDDS>"
)


class HelperWorker:
    """Does what the frames of the gateway say, until it hangs up."""

    def __init__(self, link: socket.socket) -> None:
        self._link = link
        self._sending = threading.Lock()
        self._node: FastNode | None = None

    def run(self) -> None:
        """Serve until the gateway hangs up. Raises what makes this process useless."""
        splitter = Splitter()
        while data := self._link.recv(_RECEIVE_BYTES):
            for frame in splitter.feed(data):
                self._do(frame)

    def close(self) -> None:
        """Leave the network."""
        if self._node is not None:
            self._node.close()

    def emit(self, frame: HelperFrame) -> None:
        """Tell the gateway something; without one there is nothing to live for."""
        try:
            with self._sending:
                self._link.sendall(encode(frame))
        except OSError:
            os._exit(0)

    def _do(self, frame: HelperFrame) -> None:
        if frame.op == Op.CONFIGURE:
            self._configure(frame.body)
        elif frame.op == Op.PING:
            self.emit(HelperFrame(Op.PONG, 0, frame.number))
            if self._node is not None:
                self._node.tell_drops()
        elif self._node is not None:
            self._on_endpoint(self._node, frame)

    def _configure(self, body: bytes) -> None:
        order = json.loads(body)
        try:
            raw.load("dds")
            text = selfcall.wrong() if order["test"] else ""
            if not text:
                profile = Profile(f"{_LIVELY},{order['xml']}", order["interface"])
                self._node = FastNode(
                    order["domain"], profile, order["gateway_id"], self.emit, _fail, everyone=order["everyone"]
                )
        except (DdsError, GraphUnavailable, HookError) as error:
            text = str(error)
        if self._node is None:
            self.emit(HelperFrame(Op.UNFIT, body=text.encode()))
        else:
            self.emit(HelperFrame(Op.READY, body=self._node.guid))

    def _on_endpoint(self, node: FastNode, frame: HelperFrame) -> None:
        if frame.op in (Op.OPEN_CLIENT, Op.OPEN_SERVICE):
            node.open(frame.endpoint, Spec.decode(frame.body), serves=frame.op == Op.OPEN_SERVICE)
            return
        if frame.op == Op.EXPECT:
            node.expect(frame.body[at : at + GUID_BYTES] for at in range(0, len(frame.body), GUID_BYTES))
            return
        if frame.op == Op.CLOSE:
            node.shut(frame.endpoint)
            return
        with node.end(frame.endpoint) as end:
            if isinstance(end, ClientEnd) and frame.op == Op.CALL:
                end.call(frame.number, frame.body)
            elif isinstance(end, ServiceEnd) and frame.op == Op.REPLY:
                end.reply(frame.number, frame.body)
            elif end is not None and frame.op == Op.FORGET:
                end.forget(frame.number)


def _fail(error: Exception) -> None:
    sys.stderr.write(f"ropeway's helper for Fast DDS fails: {type(error).__name__}: {error}\n")
    sys.stderr.flush()
    os._exit(1)


def main() -> None:
    """Serve the socket whose number is the first argument."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the gateway, which hangs up when it is done
    with socket.socket(fileno=int(sys.argv[1])) as link:
        link.setblocking(True)
        worker = HelperWorker(link)
        code = 0
        try:
            worker.run()
            worker.close()
        except (BadFrame, HookError, OSError) as error:
            sys.stderr.write(f"ropeway's helper for Fast DDS ends: {error}\n")
            code = 1
        sys.stderr.flush()
        # DDS may still have threads that call back into this interpreter, which must not be taken down under them.
        os._exit(code)


if __name__ == "__main__":
    main()
