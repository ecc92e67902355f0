"""Many members of one overlay, at several routers, in processes of this machine: how long all take to know all names.

``python -m bench.swarm --members 10,30`` starts real routers (``ropeway router``) and members, ten to a process,
each with a session and an overlay node of its own, all at once. Then it advertises one more name, lets them idle, kills
a router, has a member leave, and kills a process of members. ``--per-process 1`` gives each member a process.
``--direct`` lets members link with each other, as they do where they can reach each other. What was measured by when is
told as it comes; a part that does not end within ``--patience`` tells how far it came.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import json
import os
import socket
import sys
import tempfile
import time
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any, Final

import uvloop

from bench.report import table
from bench.scale import advertisement
from ropeway.networks.overlay.advert import Advertisement
from ropeway.networks.overlay.crypto.identity import Identity, write_private
from ropeway.networks.overlay.fleet import Fleet
from ropeway.networks.overlay.node import OverlayNode

IDLE_S: Final = 10.0
AFTER_KILL_S: Final = 12.0  # longer than the lease of a member
LOOK_S: Final = 0.5
TICKS: Final = os.sysconf("SC_CLK_TCK")

# ── members: one process of them ───────────────────────────────────────────────────────────────────────────────────


class Member:
    """A member that counts the names of others that it knows."""

    def __init__(self, bundle: Path, args: argparse.Namespace) -> None:
        listen = ("tls/127.0.0.1:0",) if args.direct else ()
        self.node = OverlayNode(Identity.load(bundle), routers=[args.connect], listen=listen)
        self.known = self.lost = 0
        self.changed_at = time.monotonic()
        self.node.rib.on_change(self._change)

    def _change(self, advert: Advertisement, added: bool) -> None:
        self.known += 1 if added else -1
        self.lost += not added
        self.changed_at = time.monotonic()

    def advertise(self, name: str) -> None:
        """Advertise a publisher."""
        node = self.node
        node.advertise(advertisement(node.secret, node.gateway, name))


def say(**figures: Any) -> None:
    """Write one line for who measures."""
    print(json.dumps(figures), flush=True)


async def members(args: argparse.Namespace) -> None:
    """Run members as the lines of the standard input say."""
    here = [Member(bundle, args) for bundle in args.bundles]
    loop = asyncio.get_running_loop()
    reader = asyncio.StreamReader()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    say(ready=True)
    while line := await reader.readline():
        order, number = line.decode().split()
        if order == "open":
            await asyncio.gather(*(member.node.open() for member in here))
            for member, bundle in zip(here, args.bundles, strict=True):
                for at in range(int(number)):
                    member.advertise(f"/{bundle.stem}/t{at}")
        elif order == "new":
            here[0].advertise(f"/new/t{number}")
        elif order == "leave":
            await here.pop().node.close()
        elif order == "mark":
            for member in here:
                member.lost = 0
        known = [member.known for member in here]
        at = max((member.changed_at for member in here), default=0.0)
        say(at=at, known=known, lost=sum(member.lost for member in here))


# ── the machine ────────────────────────────────────────────────────────────────────────────────────────────────────


def free_port() -> int:
    """Return a port that is free now."""
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def cpu_s(pid: int) -> float:
    """Return the processor time of a process."""
    fields = Path(f"/proc/{pid}/stat").read_text().rsplit(") ", 1)[1].split()
    return (int(fields[11]) + int(fields[12])) / TICKS


def memory_mb(pid: int) -> float:
    """Return the memory of a process that it shares with no other."""
    rollup = Path(f"/proc/{pid}/smaps_rollup").read_text().splitlines()
    return sum(int(line.split()[1]) for line in rollup if line.startswith("Private_")) / 1024


async def carried(ports: list[int]) -> tuple[int, float]:
    """Return the packets and megabytes that routers have sent to members and to each other, by links that still are."""
    sources = " or ".join(f"sport = :{port}" for port in ports)
    process = await asyncio.create_subprocess_exec("ss", "-tinH", f"( {sources} )", stdout=asyncio.subprocess.PIPE)
    words = (await process.communicate())[0].decode().split()
    found = dict.fromkeys(("data_segs_out", "data_segs_in", "bytes_sent", "bytes_received"), 0)
    for word in words:
        key, _, value = word.partition(":")
        if key in found:
            found[key] += int(value)
    return (
        found["data_segs_out"] + found["data_segs_in"],
        1e-6 * (found["bytes_sent"] + found["bytes_received"]),
    )


class Part:
    """A process of members."""

    def __init__(self, process: asyncio.subprocess.Process, count: int) -> None:
        self.process, self.count, self.pid = process, count, process.pid

    async def read(self) -> dict[str, Any]:
        """Read what it says next."""
        assert self.process.stdout is not None
        line = await self.process.stdout.readline()
        if not line:
            raise RuntimeError(f"process {self.pid} of members has ended")
        answer: dict[str, Any] = json.loads(line)
        return answer

    async def order(self, order: str, number: int = 0) -> dict[str, Any]:
        """Give it an order and return what it says once it is done."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{order} {number}\n".encode())
        await self.process.stdin.drain()
        return await self.read()


class Swarm:
    """Routers and members, as processes."""

    def __init__(self, args: argparse.Namespace, members: int, directory: Path) -> None:
        self.args, self.members, self.directory = args, members, directory
        self.ports = [free_port() for _ in range(args.routers)]
        self.routers: list[asyncio.subprocess.Process] = []
        self.parts: list[Part] = []
        self.log = (directory / "log").open("w+b")

    async def start(self) -> None:
        """Start the processes, and wait until members are ready to join."""
        fleet = Fleet.create("swarm", self.directory / "fleet")
        endpoints = [f"tls/127.0.0.1:{port}" for port in self.ports]
        for number, endpoint in enumerate(endpoints):
            bundle = self.directory / f"router{number}.ropeway"
            write_private(bundle, fleet.issue(bundle.stem, role="router").to_text())
            mesh = [word for other in endpoints[:number] for word in ("--connect", other)]
            words = ("-m", "ropeway", "router", "-i", str(bundle), "--log-level", "error", "--listen", endpoint, *mesh)
            self.routers.append(await asyncio.create_subprocess_exec(sys.executable, *words, stderr=self.log))
        env = {**os.environ, "RUST_BACKTRACE": "0"}
        bundles = []
        for number in range(self.members):
            bundle = self.directory / f"m{number}.ropeway"
            write_private(bundle, fleet.issue(bundle.stem).to_text())
            bundles.append(str(bundle))
        together = min(self.args.per_process, self.members // 4)
        for number, at in enumerate(range(0, self.members, together)):
            some = bundles[at : at + together]
            words = ["-m", "bench.swarm", "--connect", endpoints[number % len(endpoints)], "--bundles", *some]
            if self.args.direct:
                words.append("--direct")
            pipe = asyncio.subprocess.PIPE
            process = await asyncio.create_subprocess_exec(
                sys.executable, *words, stdin=pipe, stdout=pipe, stderr=self.log, env=env
            )
            self.parts.append(Part(process, len(some)))
            if number % 4 == 3:  # starting takes more than running
                await self.parts[-1].read()
        await asyncio.gather(*(part.read() for number, part in enumerate(self.parts) if number % 4 != 3))

    async def all(self, order: str, number: int = 0) -> list[dict[str, Any]]:
        """Give all processes of members an order."""
        return await asyncio.gather(*(part.order(order, number) for part in self.parts))

    async def know(self, names: int, began: float, parts: list[Part] | None = None) -> float:
        """Wait until each member knows so many names of others; return how many seconds it took since ``began``."""
        over = time.monotonic() + self.args.patience
        while True:
            answers = await asyncio.gather(*(part.order("look") for part in (parts or self.parts)))
            known = [count for answer in answers for count in answer["known"]]
            if all(count == names for count in known):
                return max(answer["at"] for answer in answers) - began
            if time.monotonic() > over:
                cpu, router_cpu = self.cpu_s()
                raise RuntimeError(
                    f"after {time.monotonic() - began:.0f} s members know {min(known)} to {max(known)} names, "
                    f"{sum(known) / len(known):.0f} in the mean, of {names}; {cpu / self.members:.1f} s of the "
                    f"processor each member, {router_cpu / len(self.routers):.1f} s each router; links made anew "
                    f"{self.noted('links are made anew')} times, {self.noted('panicked at')} panics"
                )
            await asyncio.sleep(LOOK_S)

    def noted(self, words: str) -> int:
        """Return how often all processes have said something."""
        return (self.directory / "log").read_text(errors="replace").count(words)

    def cpu_s(self) -> tuple[float, float]:
        """Return the processor time of all members, and of all routers."""
        living = [router for router in self.routers if router.returncode is None]
        return sum(cpu_s(part.pid) for part in self.parts), sum(cpu_s(router.pid) for router in living)

    async def end(self) -> None:
        """Kill all processes."""
        for process in [*(part.process for part in self.parts), *self.routers]:
            with contextlib.suppress(ProcessLookupError):
                process.kill()
            await process.wait()
        self.log.close()


@contextlib.asynccontextmanager
async def swarm(args: argparse.Namespace, members: int) -> AsyncIterator[Swarm]:
    """Run a swarm."""
    with tempfile.TemporaryDirectory() as directory:
        made = Swarm(args, members, Path(directory))
        try:
            await made.start()
            yield made
        finally:
            await made.end()


async def joining(made: Swarm, names: int) -> list[Any]:
    """Have all members join at once."""
    memory = sum(memory_mb(part.pid) for part in made.parts)
    (cpu, router_cpu), began = made.cpu_s(), time.monotonic()
    opening, started = [], began
    for part in made.parts:
        started = time.monotonic()
        opening.append(asyncio.create_task(part.order("open", names)))
        await asyncio.sleep(made.args.stagger)
    await asyncio.gather(*opening)
    if made.args.stagger:
        began = started
    took_s = await made.know((made.members - 1) * names, began)
    cpu_now, router_cpu_now = made.cpu_s()
    packets, megabytes = await carried(made.ports)
    grown_mb = sum(memory_mb(part.pid) for part in made.parts) - memory
    return [
        took_s,
        (cpu_now - cpu) / made.members,
        grown_mb / made.members,
        (router_cpu_now - router_cpu) / len(made.routers),
        sum(memory_mb(router.pid) for router in made.routers) / len(made.routers),
        packets,
        megabytes,
        made.noted("links are made anew"),
        made.noted("panicked at"),
    ]


async def told(made: Swarm, known: int, number: int) -> float:
    """Have a member advertise one more name; return after how many milliseconds all others know ``known``."""
    owner, *others = made.parts
    began = time.monotonic()
    await owner.order("new", number)
    return 1e3 * await made.know(known, began, others)


async def running(made: Swarm, names: int) -> list[Any]:
    """Have them idle, and advertise one more name."""
    (cpu, router_cpu), (packets, megabytes) = made.cpu_s(), await carried(made.ports)
    began = time.monotonic()
    await asyncio.sleep(IDLE_S)
    (cpu_now, router_cpu_now), (packets_now, megabytes_now) = made.cpu_s(), await carried(made.ports)
    idle_s = time.monotonic() - began
    return [
        100 * (cpu_now - cpu) / idle_s / made.members,
        100 * (router_cpu_now - router_cpu) / idle_s / len(made.routers),
        (packets_now - packets) / idle_s,
        1e3 * (megabytes_now - megabytes) / idle_s,
        await told(made, (made.members - 1) * names + 1, 0),
    ]


async def losing(made: Swarm, names: int) -> list[Any]:
    """Kill a router, have a member leave, and kill a process of members."""
    known = (made.members - 1) * names + 1  # by all but the first member, which has told the last of them
    await made.all("mark")
    made.routers[0].kill()
    await made.routers[0].wait()
    await asyncio.sleep(AFTER_KILL_S)
    answers = await made.all("mark")
    lost = sum(answer["lost"] for answer in answers)
    short = sum(count < known - 1 for answer in answers for count in answer["known"])
    again_ms = await told(made, known + 1, 1)
    _, *others, killed, leaving = made.parts
    known += 1 - names
    began = time.monotonic()
    await leaving.order("leave")
    left_ms = 1e3 * await made.know(known, began, [*others, killed])
    began = time.monotonic()
    killed.process.kill()
    return [lost, short, again_ms, left_ms, await made.know(known - killed.count * names, began, others)]


async def measure(args: argparse.Namespace) -> None:
    """Print the tables."""
    joined, ran, went = [], [], []
    for members in args.members:
        async with swarm(args, members) as made:
            what = [members, members * args.names]
            for rows, part in ((joined, joining), (ran, running), (went, losing)):
                try:
                    rows.append([*what, *await part(made, args.names)])
                except RuntimeError as error:
                    print(f"{members} members: {error}", flush=True)
                    break
                print(rows[-1], file=sys.stderr, flush=True)
    head = ["members", "names"]
    columns = ["all know all, s", "CPU of each, s", "memory of each, MB", "CPU of a router, s"]
    table(
        "joining at once",
        [*head, *columns, "memory of a router, MB", "packets of routers", "MB of routers", "links made anew", "panics"],
        joined,
    )
    columns = ["% of a core each", "% of a core, router", "packets/s of routers", "kB/s of routers"]
    table("idle, then one more name", [*head, *columns, "new name known, ms"], ran)
    columns = ["router killed: names lost", "members short", "then a new name, ms", "member leaves, ms"]
    table("going", [*head, *columns, "process of members killed, s"], went)


def main() -> None:
    """Measure, or be a process of members."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--members", type=lambda text: [int(word) for word in text.split(",")], default=[10, 30])
    parser.add_argument("--names", type=int, default=100, help="of each member")
    parser.add_argument("--per-process", type=int, default=10)
    parser.add_argument("--routers", type=int, default=3)
    parser.add_argument("--stagger", type=float, default=0.0, help="seconds between the starts of two processes")
    parser.add_argument("--direct", action="store_true")
    parser.add_argument("--patience", type=float, default=120.0, help="seconds for each part")
    parser.add_argument("--connect", help=argparse.SUPPRESS)
    parser.add_argument("--bundles", nargs="+", type=Path, help=argparse.SUPPRESS)
    args = parser.parse_args()
    uvloop.run(members(args) if args.bundles else measure(args))


if __name__ == "__main__":
    main()
