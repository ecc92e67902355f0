"""Probes of the link itself, each a process: round trips of small datagrams, and a bare TCP connection that fills it.

They are told the window that counts as the ends are (see ``bench.wan.ends``).
"""

from __future__ import annotations

import argparse
import contextlib
import json
import socket
import struct
import sys
import threading
import time

__all__ = ["PORT"]

PORT = 17999
PING_HZ = 50.0
CHUNK = bytes(64 * 1024)
_HEAD = struct.Struct("<Id")


def window() -> tuple[float, float]:
    """Wait for the times between which it counts."""
    began, ended = map(float, sys.stdin.readline().split())
    return began, ended


def echo(args: argparse.Namespace) -> None:
    """Send every datagram back."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.bind((args.host, PORT))
        print("ready", flush=True)
        while True:
            data, where = sock.recvfrom(2048)
            sock.sendto(data, where)


def ping(args: argparse.Namespace) -> None:
    """Send a datagram 50 times a second; tell when each left and how long its way there and back took."""
    rows: list[tuple[float, float]] = []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sock:
        sock.connect((args.host, PORT))

        def receive() -> None:
            while True:
                left = _HEAD.unpack_from(sock.recv(2048))[1]
                rows.append((left, time.time() - left))

        threading.Thread(target=receive, daemon=True).start()
        print("ready", flush=True)
        began, ended = window()
        sent, number = 0, 0
        time.sleep(max(0.0, began - time.time()))
        while (now := time.time()) < ended:
            sock.send(_HEAD.pack(number, now).ljust(64, b"\0"))
            sent, number = sent + 1, number + 1
            time.sleep(max(0.0, began + number / PING_HZ - time.time()))
        time.sleep(2.0)
        print(json.dumps({"sent": sent, "rows": rows}), flush=True)


def drain(args: argparse.Namespace) -> None:
    """Take what a bare connection brings; tell when and how much came within the window."""
    came: list[tuple[float, int]] = []
    with socket.create_server((args.host, args.port)) as server:
        print("ready", flush=True)
        connection, _ = server.accept()

        def receive() -> None:
            while size := len(connection.recv(1 << 20)):
                came.append((time.time(), size))

        threading.Thread(target=receive, daemon=True).start()
        began, ended = window()
        time.sleep(max(0.0, ended - time.time()))
    inside = [(at, size) for at, size in came if began <= at < ended]
    print(json.dumps({"rows": inside}), flush=True)


def flood(args: argparse.Namespace) -> None:
    """Fill a bare connection until it is ended."""
    with socket.socket() as sock:
        if args.congestion:
            sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_CONGESTION, args.congestion.encode())
        sock.connect((args.host, args.port))
        print("ready", flush=True)
        with contextlib.suppress(ConnectionError):  # the reader has seen enough
            while True:
                sock.sendall(CHUNK)


def main() -> None:
    """The command line."""
    roles = {"echo": echo, "ping": ping, "drain": drain, "flood": flood}
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("role", choices=list(roles))
    parser.add_argument("--host", required=True)
    parser.add_argument("--port", type=int, default=PORT)
    parser.add_argument("--congestion", default="")
    args = parser.parse_args()
    roles[args.role](args)


if __name__ == "__main__":
    main()
