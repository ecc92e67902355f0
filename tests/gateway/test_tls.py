"""ropeway.gateway.tls: wss between gateways, with certificates made for each test run."""

from __future__ import annotations

import asyncio
import itertools
import shutil
import ssl
import warnings
from collections.abc import Iterable
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import ConfigError, ConnectFailed
from ropeway.gateway.config import config
from ropeway.gateway.config.tls_model import ListenTls, RemoteTls
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.tls import certificate_names, client_context, server_context
from ropeway.listener.connection import Limits
from ropeway.listener.websocket import connect
from ropeway.networks.memory.graph import MemoryGraph
from ropeway.networks.rosbridge.client import RosbridgeGraph
from ropeway.qos import QoS
from ropeway.types import TypeRegistry
from tests.support.authority import Authority
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.ports import free_port
from tests.support.until import until

_numbers = itertools.count()
LIMITS = Limits(open_timeout_s=2.0)


@pytest.fixture(scope="module")
def ours(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    """The authority that both sides trust."""
    return Authority(tmp_path_factory.mktemp("ours"), "ours")


@pytest.fixture(scope="module")
def strangers(tmp_path_factory: pytest.TempPathFactory) -> Authority:
    """One that nobody trusts."""
    return Authority(tmp_path_factory.mktemp("strangers"), "strangers")


async def gateway(
    stack: AsyncExitStack, name: str, remotes: list[dict[str, Any]], tls: dict[str, str] | None = None
) -> tuple[Gateway, MemoryGraph]:
    """A gateway and a robot on its network."""
    network = f"tls-{name}-{next(_numbers)}"
    settings = {"name": name, "graphs": [f"memory:{network}"], "listen": ["wss://127.0.0.1:0"] if tls else []}
    made = Gateway(config.parse({"gateway": {**settings, "tls": tls}, "remotes": remotes}))
    await stack.enter_async_context(made)
    robot = MemoryGraph(network, node="/robot")
    await robot.open()
    stack.push_async_callback(robot.close)
    return made, robot


def url(gateway: Gateway, host: str = "127.0.0.1") -> str:
    return f"wss://{host}:{gateway.servers[0].listeners[0].port}"


async def attempt(address: str, tls: dict[str, Any]) -> ConnectFailed:
    """Connect, which must fail."""
    graph = RosbridgeGraph(
        address,
        registry=TypeRegistry(),
        ssl_context=client_context(RemoteTls.model_validate(tls), "remotes[0].tls"),
        limits=LIMITS,
    )
    with pytest.raises(ConnectFailed) as failed:
        await graph.open()
    return failed.value


@pytest.mark.parametrize("mutual", [False, True])
async def test_two_gateways(stack: AsyncExitStack, ours: Authority, mutual: bool) -> None:
    """Topics cross a wss link, where asked with certificates on both sides."""
    listener = {**ours.sign("cloud"), **({"ca": ours.file} if mutual else {})}
    own = ours.sign("robot") if mutual else {}
    cloud, there = await gateway(stack, "cloud", [], listener)
    item = {"name": "/x", "type": STRING}
    robot, here = await gateway(
        stack, "robot", [{"address": url(cloud), "tls": {"ca": ours.file, **own}, "publish": [item]}]
    )
    inbox = Inbox()
    await there.create_subscription("/x", STRING, QoS(), inbox)
    publisher = await here.create_publisher("/x", STRING)
    await until(lambda: publisher.subscribers == 1)
    publisher.publish(sample("secret"))
    publisher.publish(sample("x" * 3_000_000))
    await inbox.wait(2)
    assert inbox.payloads == [text("secret"), text("x" * 3_000_000)]
    assert robot.remotes[0].graph.peer is not None
    assert robot.remotes[0].graph.peer.connection.secure
    (session,) = cloud.servers[0].sessions
    assert session.peer.connection.secure


async def test_unknown_authority(
    stack: AsyncExitStack, ours: Authority, strangers: Authority, caplog: pytest.LogCaptureFixture
) -> None:
    """A certificate of an unknown authority is refused; the message says where to name it, and no try will help."""
    cloud, _ = await gateway(stack, "cloud", [], ours.sign("cloud"))
    for tls in ({"ca": strangers.file}, {}):
        failed = await attempt(url(cloud), tls)
        assert not failed.retryable
        assert "its certificate is not trusted" in str(failed)
        assert "tls.ca" in str(failed)
    item = {"name": "/x", "type": STRING}
    robot, _ = await gateway(
        stack, "robot", [{"address": url(cloud), "tls": {"ca": strangers.file}, "publish": [item]}]
    )
    await until(lambda: robot.status()["remotes"][0]["error"])
    assert "not trusted" in robot.status()["remotes"][0]["error"]
    assert robot.status()["routes"][0]["state"] == "waiting to retry"


@pytest.mark.parametrize(
    ("host", "expired", "reason"),
    [
        ("example.org", False, "is not for this host (IP address mismatch"),
        ("10.1.2.3", False, "is not for this host (IP address mismatch"),
        ("127.0.0.1", True, "has expired"),
    ],
)
async def test_wrong_certificate(stack: AsyncExitStack, ours: Authority, host: str, expired: bool, reason: str) -> None:
    """A certificate for another host, or an old one, is refused with the reason."""
    cloud, _ = await gateway(stack, "cloud", [], ours.sign("cloud", host=host, expired=expired))
    failed = await attempt(url(cloud), {"ca": ours.file})
    assert not failed.retryable
    assert reason in str(failed)


async def test_names(stack: AsyncExitStack, ours: Authority) -> None:
    """A certificate is checked for the host that the address names."""
    cloud, _ = await gateway(stack, "cloud", [], ours.sign("cloud", host="localhost"))
    context = client_context(RemoteTls(ca=ours.file), "tls")
    graph = RosbridgeGraph(url(cloud, "localhost"), registry=TypeRegistry(), ssl_context=context, limits=LIMITS)
    await graph.open()
    await graph.close()


async def test_no_verification(stack: AsyncExitStack, ours: Authority) -> None:
    """With verify false any certificate is taken."""
    cloud, _ = await gateway(stack, "cloud", [], ours.sign("cloud", host="example.org", expired=True))
    context = client_context(RemoteTls(verify=False), "tls")
    graph = RosbridgeGraph(url(cloud), registry=TypeRegistry(), ssl_context=context, limits=LIMITS)
    await graph.open()
    assert graph.remote or graph.peer is not None
    await graph.close()


@pytest.mark.parametrize("own", ["none", "stranger"])
async def test_client_certificate_required(
    stack: AsyncExitStack, ours: Authority, strangers: Authority, own: str
) -> None:
    """A client without the certificate that is asked for, or with a wrong one, is refused and told so."""
    cloud, _ = await gateway(stack, "cloud", [], {**ours.sign("cloud"), "ca": ours.file})
    certificate = strangers.sign("robot") if own == "stranger" else {}
    failed = await attempt(url(cloud), {"ca": ours.file, **certificate})
    assert "closed the connection during the handshake" in str(failed)
    assert "tls.certificate" in str(failed)
    assert not cloud.servers[0].sessions


async def test_plain_client_at_a_secure_port(stack: AsyncExitStack, ours: Authority) -> None:
    """Ws at a wss port, and wss at a ws port, fail with what they found; the server lives on."""
    cloud, _ = await gateway(stack, "cloud", [], ours.sign("cloud"))
    graph = RosbridgeGraph(url(cloud).replace("wss", "ws"), registry=TypeRegistry(), limits=LIMITS)
    with pytest.raises(ConnectFailed, match="closed the connection during the handshake"):
        await graph.open()
    other = Gateway(config.parse({"gateway": {"name": "p", "graphs": ["memory:p"], "listen": ["ws://127.0.0.1:0"]}}))
    await stack.enter_async_context(other)
    await attempt(url(other), {"ca": ours.file})
    context = client_context(RemoteTls(ca=ours.file), "tls")
    good = RosbridgeGraph(url(cloud), registry=TypeRegistry(), ssl_context=context, limits=LIMITS)
    await good.open()
    await good.close()


async def test_garbage_at_a_secure_port(
    stack: AsyncExitStack, ours: Authority, caplog: pytest.LogCaptureFixture
) -> None:
    """Bytes that are no TLS, and half a handshake, cost one line in the log."""
    cloud, _ = await gateway(stack, "cloud", [], ours.sign("cloud"))
    port = cloud.servers[0].listeners[0].port
    for data in (b"\0" * 500, b"\x16\x03\x01\x02\x00\x01", b"GET / HTTP/1.1\r\n\r\n"):
        _, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(data)
        await writer.drain()
        writer.transport.abort()
    await until(lambda: caplog.messages)
    context = client_context(RemoteTls(ca=ours.file), "tls")
    graph = RosbridgeGraph(url(cloud), registry=TypeRegistry(), ssl_context=context, limits=LIMITS)
    await graph.open()
    await graph.close()
    assert len(caplog.messages) == 1
    assert "bad handshake" in caplog.messages[0]


def test_old_versions(ours: Authority) -> None:
    """TLS before 1.2 is not spoken."""
    server = server_context(ListenTls.model_validate(ours.sign("cloud")))
    client = client_context(RemoteTls(ca=ours.file), "tls")
    assert server is not None
    assert client is not None
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        assert server.minimum_version >= ssl.TLSVersion.TLSv1_2
        assert client.minimum_version >= ssl.TLSVersion.TLSv1_2
    assert server_context(None) is None
    assert client_context(None, "tls") is None


def test_files_that_do_not_fit(ours: Authority, strangers: Authority, tmp_path: Path) -> None:
    """A key that is not the certificate's, and files that are no PEM, are configuration errors with their path."""
    one, two = ours.sign("one"), strangers.sign("two")
    junk = tmp_path / "junk.pem"
    junk.write_text("hello")
    with pytest.raises(ConfigError) as error:
        server_context(ListenTls(certificate=one["certificate"], key=two["key"]))
    assert error.value.problems[0][0] == "gateway.tls"
    with pytest.raises(ConfigError) as error:
        client_context(RemoteTls(certificate=str(junk), key=one["key"]), "remotes[3].tls")
    assert error.value.problems[0][0] == "remotes[3].tls"
    with pytest.raises(ConfigError) as error:
        client_context(RemoteTls(ca=str(junk)), "remotes[4].tls")
    assert error.value.problems[0][0] == "remotes[4].tls.ca"
    with pytest.raises(ConfigError) as error:
        server_context(ListenTls.model_validate({**one, "ca": str(junk)}))
    assert error.value.problems[0][0] == "gateway.tls.ca"


async def secured(stack: AsyncExitStack, ours: Authority, directory: Path, **tls: str) -> tuple[Gateway, Path]:
    """A gateway that trusts the authorities of a file, which a test may change."""
    trusted = directory / "trusted.pem"
    shutil.copy(ours.file, trusted)
    made, _ = await gateway(stack, f"secured{next(_numbers)}", [], {**ours.sign("server"), "ca": str(trusted), **tls})
    return made, trusted


def join(files: Iterable[str], to: Path) -> None:
    to.write_text("".join(Path(file).read_text() for file in files))


async def comes_in(made: Gateway, ours: Authority, client: dict[str, str]) -> bool:
    """Whether a client with this certificate comes in."""
    context = client_context(RemoteTls.model_validate({"ca": ours.file, **client}), "remotes[0].tls")
    try:
        connection = await connect(url(made), limits=LIMITS, ssl_context=context)
    except ConnectFailed:
        return False
    connection.close(1000, "")
    await connection.wait_closed()
    return True


async def test_an_authority_that_is_gone(
    stack: AsyncExitStack, ours: Authority, strangers: Authority, tmp_path: Path
) -> None:
    """An authority that was taken out of the file is trusted no longer after SIGHUP, and who came by it is closed."""
    made, trusted = await secured(stack, ours, tmp_path)
    join((ours.file, strangers.file), trusted)
    made.reload()
    theirs, mine = strangers.sign("theirs"), ours.sign("mine")
    assert await comes_in(made, ours, theirs)
    context = client_context(RemoteTls.model_validate({"ca": ours.file, **theirs}), "remotes[0].tls")
    standing = await connect(url(made), limits=LIMITS, ssl_context=context)
    shutil.copy(ours.file, trusted)
    made.reload()
    await until(lambda: standing.closed)
    assert not await comes_in(made, ours, theirs)
    assert await comes_in(made, ours, mine)
    standing.abort("the test is over")
    await standing.wait_closed()


@pytest.mark.parametrize("kind", ["wss", "iorts"])
async def test_a_remote_whose_authority_is_gone(
    stack: AsyncExitStack, ours: Authority, strangers: Authority, tmp_path: Path, kind: str
) -> None:
    """After SIGHUP a remote whose authority is trusted no longer is not spoken to, until it is trusted again."""
    trusted = tmp_path / "trusted.pem"
    join((ours.file, strangers.file), trusted)
    network, port = f"tls-there{next(_numbers)}", free_port()
    settings = {"name": "there", "graphs": [f"memory:{network}"], "listen": [f"{kind}://127.0.0.1:{port}"]}
    theirs = {"tls": strangers.sign("there"), "store": {"path": "memory:"}}
    await stack.enter_async_context(Gateway(config.parse({"gateway": {**settings, **theirs}})))
    item = {"name": "/A/x", "type": STRING}
    made, _ = await gateway(
        stack,
        "here",
        [{"address": f"{kind}://127.0.0.1:{port}", "tls": {"ca": str(trusted)}, "publish": [item]}],
    )
    (remote,) = made.remotes
    await until(lambda: remote.state == "connected")
    made.reload()
    assert remote.state == "connected"  # nothing has changed
    shutil.copy(ours.file, trusted)
    made.reload()
    await until(lambda: "certificate" in str(remote.status()["error"]))
    assert remote.state != "connected"
    trusted.write_text("junk")
    with pytest.raises(ConfigError, match="holds no certificates"):
        made.reload()
    join((ours.file, strangers.file), trusted)
    made.reload()
    await until(lambda: remote.state == "connected")


async def test_a_remote_is_shown_the_new_token(stack: AsyncExitStack, tmp_path: Path) -> None:
    """After SIGHUP the token that a file has now is what the next connection to a remote shows."""
    token = tmp_path / "token"
    token.write_text("old")
    network = f"token-{next(_numbers)}"
    auth = {"tokens": [{"token": {"file": str(token)}}]}
    settings = {"name": "there", "graphs": [f"memory:{network}"], "listen": ["ws://127.0.0.1:0"], "auth": auth}
    there = await stack.enter_async_context(Gateway(config.parse({"gateway": settings})))
    address = f"ws://127.0.0.1:{there.servers[0].listeners[0].port}"
    item = {"name": "/x", "type": STRING}
    here, _ = await gateway(stack, "here", [{"address": address, "token": {"file": str(token)}, "publish": [item]}])
    (remote,) = here.remotes
    await until(lambda: remote.state == "connected")
    token.write_text("new")
    here.reload()
    there.reload()  # which closes whoever showed the old one
    await until(lambda: remote.status()["connections"] == 2 and remote.state == "connected")


async def test_a_revoked_certificate(stack: AsyncExitStack, ours: Authority, tmp_path: Path) -> None:
    """A certificate on the list of revoked ones is refused, others are not; the list is read again at SIGHUP."""
    good, bad = ours.sign("good"), ours.sign("bad")
    revoked = tmp_path / "revoked.pem"
    revoked.write_bytes(ours.revoke())
    made, _ = await secured(stack, ours, tmp_path, crl=str(revoked))
    assert await comes_in(made, ours, bad)
    revoked.write_bytes(ours.revoke(bad["certificate"]))
    made.reload()
    assert not await comes_in(made, ours, bad)
    assert await comes_in(made, ours, good)


async def test_a_list_that_is_none(stack: AsyncExitStack, ours: Authority, tmp_path: Path) -> None:
    """A file without a list of revoked certificates is an error, at a reload as well, which changes nothing then."""
    revoked = tmp_path / "revoked.pem"
    revoked.write_bytes(ours.revoke())
    made, _ = await secured(stack, ours, tmp_path, crl=str(revoked))
    revoked.write_text("nothing")
    with pytest.raises(ConfigError, match=r"gateway\.tls\.crl"):
        made.reload()
    assert await comes_in(made, ours, ours.sign("good"))


async def test_names_of_the_certificate(ours: Authority, tmp_path: Path) -> None:
    """The listeners are known by the names that their certificate has."""
    made = ListenTls.model_validate(ours.sign("named", host="Robot.Example.com"))
    assert certificate_names(made) == {"robot.example.com"}
    assert certificate_names(ListenTls.model_validate(ours.sign("addressed", host="10.0.0.7"))) == {"10.0.0.7"}


@pytest.mark.parametrize(("spoken", "expected", "told"), [("ws", "wss", "TLS"), ("wss", "ws", "ws://")])
async def test_ws_and_wss_mixed_up(
    stack: AsyncExitStack, ours: Authority, caplog: pytest.LogCaptureFixture, spoken: str, expected: str, told: str
) -> None:
    """Where one side speaks ws:// and the other wss://, both say so, at once."""
    name = f"mixed{next(_numbers)}"
    tls = ours.sign("server") if expected == "wss" else None
    settings = {"name": name, "graphs": [f"memory:{name}"], "listen": [f"{expected}://127.0.0.1:0"], "tls": tls}
    made = Gateway(config.parse({"gateway": settings}))
    await stack.enter_async_context(made)
    address = f"{spoken}://127.0.0.1:{made.servers[0].listeners[0].port}"
    context = client_context(RemoteTls.model_validate({"ca": ours.file}), "") if spoken == "wss" else None
    with pytest.raises(ConnectFailed, match=told):
        await connect(address, limits=LIMITS, ssl_context=context)
    await until(lambda: "bad handshake" in caplog.text)
    assert "wss://" in caplog.text
