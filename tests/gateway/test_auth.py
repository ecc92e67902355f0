"""gateway.auth, gateway.globs and tokens of remotes: read strictly, kept out of every text, and in force."""

from __future__ import annotations

import asyncio
import hashlib
import json
import ssl
from contextlib import AsyncExitStack
from pathlib import Path
from typing import Any

import pytest

from ropeway.errors import ConfigError
from ropeway.gateway.auth import make_door
from ropeway.gateway.config import config
from ropeway.gateway.config.auth_model import parse_glob
from ropeway.gateway.gateway import Gateway
from ropeway.gateway.process.supervisor import Supervisor
from ropeway.listener.authorization import EVERYTHING, Role
from ropeway.listener.http import HttpRequest
from tests.gateway.test_tls import gateway, url
from tests.support.authority import Authority
from tests.support.inbox import Inbox
from tests.support.messages import STRING, sample, text
from tests.support.ports import free_port
from tests.support.until import until
from tests.support.websocket import Client, fetch

TOKEN = "a-token-that-must-not-be-seen"


@pytest.fixture
def token_file(tmp_path: Path) -> Path:
    file = tmp_path / "token"
    file.write_text(TOKEN + "\n")
    return file


def problems(**gateway: Any) -> list[tuple[str, str]]:
    """What is wrong with it; a listener that others reach is there, too."""
    with pytest.raises(ConfigError) as error:
        config.parse({"gateway": {"name": "g", "graphs": ["memory:x"], **gateway}})
    assert TOKEN not in str(error.value)
    return error.value.problems


def settings(**gateway: Any) -> config.GatewayConfig:
    return config.parse({"gateway": {"name": "g", "graphs": ["memory:x"], **gateway}}).gateway


# ── reading ────────────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.mark.parametrize(
    ("auth", "path", "words"),
    [
        ({"tokens": TOKEN}, "tokens", "a token itself is not written here"),
        ({"tokens": [TOKEN]}, "tokens[0]", "a token itself is not written here"),
        ({"tokens": [{"token": TOKEN}]}, "tokens[0].token", 'expected {"env": "NAME"} or {"file": "PATH"}'),
        ({"tokens": [{"hash": TOKEN}]}, "tokens[0].hash", "expected sha256:<64 hexadecimal digits>"),
        ({"tokens": [{"role": "all"}]}, "tokens[0]", 'expected either "token" or "hash"'),
        ({"tokens": [{"token": {}}]}, "tokens[0].token", 'expected either "env" or "file"'),
        ({"tokens": [{"token": {"file": "/none"}}]}, "tokens[0].token.file", "does not exist"),
        (
            {"tokens": [{"token": {"env": "A"}, "role": "viewr"}], "roles": {"viewer": {}}},
            "tokens[0].role",
            '"viewer"?',
        ),
        ({"default_role": "nobody"}, "default_role", "expected one of all, got"),
        ({"tokns": []}, "tokns", 'did you mean "tokens"?'),
        ({"roles": {"v": {"publsh": []}}}, "roles.v.publsh", 'did you mean "publish"?'),
        ({"roles": {"v": {"deny": {"cal": []}}}}, "roles.v.deny.cal", 'did you mean "call"?'),
        ({"roles": {"v": {"publish": "/x"}}}, "roles.v.publish", "expected a list"),
        ({"roles": {"v": {"publish": [""]}}}, "roles.v.publish[0]", "expected a name or a pattern"),
        ({"roles": {"v": {"call": [], "call_service": []}}}, "roles.v.call_service", 'another spelling of "call"'),
        ({"roles": {"v": {"messages_per_s": 0}}}, "roles.v.messages_per_s", "expected a number above 0"),
        ({"roles": []}, "roles", "expected an object"),
        ({"certificates": [{}]}, "certificates[0]", 'expected "common_name", "san" or "fingerprint"'),
        ({"certificates": [{"fingerprint": "ab"}]}, "certificates[0].fingerprint", "expected the SHA-256"),
        ({"certificates": [{"common_name": "*"}]}, "certificates", "needs gateway.tls with ca"),
    ],
)
def test_faults(auth: dict[str, Any], path: str, words: str) -> None:
    """Every fault is told with its path and the nearest key, and never shows a token."""
    found = problems(auth=auth)
    assert any(where == f"gateway.auth.{path}" and words in said for where, said in found), found


def test_faults_elsewhere() -> None:
    """A glob that is no list, and a remote's token in clear, are faults with their path."""
    ((path, said),) = problems(globs={"topics_glob": "/a"})
    assert path.startswith("gateway.globs.topics")
    assert "expected a list of patterns" in said
    with pytest.raises(ConfigError) as error:
        config.parse([{"address": "ws://x", "token": TOKEN}])
    assert error.value.problems[0][0] == "remotes[0].token"
    assert TOKEN not in str(error.value)


@pytest.mark.parametrize(
    ("value", "patterns"),
    [
        ("", None),
        (None, None),
        ("[]", ()),
        ([], ()),
        ("['/a', \"/b*\"]", ("/a", "/b*")),
        ("[/a,/b]", ("/a", "/b")),
        (["/a"], ("/a",)),
    ],
)
def test_globs(value: Any, patterns: Any) -> None:
    """A glob is written as rosbridge has it, or as a list."""
    assert parse_glob(value) == patterns


def test_listeners() -> None:
    """A listener that others reach needs tokens, certificates or ``insecure``; a default role of everything is none."""
    everywhere = {"listen": ["ws://0.0.0.0:0"]}
    assert "without authentication" in problems(**everywhere)[0][1]
    token = {"token": {"env": "A"}}
    settings(**everywhere, insecure=True)
    settings(**everywhere, auth={"tokens": [token]})
    settings(**everywhere, auth={"tokens": [token], "default_role": "v", "roles": {"v": {}}})
    assert problems(**everywhere, auth={"tokens": [token], "default_role": "all"})
    assert problems(**everywhere, auth={"roles": {"v": {}}, "default_role": "v"})


def test_round_trip(token_file: Path) -> None:
    """What a worker gets is the same configuration, with references and no token."""
    gateway = {
        "graphs": ["memory:x"],
        "auth": {
            "tokens": [{"token": {"file": str(token_file)}, "role": "v"}, {"hash": "sha256:" + "0" * 64}],
            "roles": {"v": {"advertise_service": ["/s"], "deny": {"publish": ["/x"]}, "max_clients": 3}},
            "origins": ["https://x"],
        },
        "globs": {"topics_glob": "['/a']", "services": []},
        "clients": {"path": "/ros", "call_timeout_s": 0},
    }
    made = config.parse({"gateway": gateway, "remotes": [{"address": "ws://x", "token": {"env": "A"}}]})
    written = json.dumps(made.to_json())
    assert TOKEN not in written
    assert config.parse(json.loads(written)) == made
    assert made.gateway.auth.roles["v"].serve == ("/s",)


def test_schema() -> None:
    """The schema knows the new keys and their other spellings."""
    definitions = config.Config.schema()["$defs"]
    assert {"call", "call_service", "deny", "max_clients"} <= definitions["RoleConfig"]["properties"].keys()
    assert {"topics", "topics_glob", "params_glob"} <= definitions["GlobsConfig"]["properties"].keys()


# ── the door ───────────────────────────────────────────────────────────────────────────────────────────────────────


def asked(token: str = "") -> HttpRequest:
    return HttpRequest("GET", f"/?token={token}" if token else "/", "HTTP/1.1", {})


def test_door(token_file: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Tokens of files, of the environment and by hash give their roles; nobody else comes in."""
    monkeypatch.setenv("ROPEWAY_TEST_TOKEN", "from-the-environment")
    hashed = "sha256:" + hashlib.sha256(b"hashed").hexdigest()
    door = make_door(
        settings(
            auth={
                "tokens": [
                    {"token": {"file": str(token_file)}, "role": "a"},
                    {"token": {"env": "ROPEWAY_TEST_TOKEN"}, "role": "b"},
                    {"hash": hashed},
                ],
                "roles": {"a": {"call": ["/s"]}, "b": {"send_goal": ["/g"], "bytes_per_s": 5}},
            },
            globs={"topics": ["/x"], "topics_pub": ["/y"]},
        )
    )
    assert door.role_of(asked(TOKEN)) == Role("a", {"call_service": ("/s",)})
    assert door.role_of(asked("from-the-environment")) == Role("b", {"send_action_goal": ("/g",)}, bytes_per_s=5)
    assert door.role_of(asked("hashed")) is EVERYTHING
    assert not isinstance(door.role_of(asked()), Role)
    assert (door.globs.topics_pub, door.globs.topics_sub) == (("/y", "/x"), ("/x",))
    assert TOKEN not in repr(door)


def test_door_without_tokens() -> None:
    """Without credentials to ask for, everybody has the default role, and without that may do everything."""
    assert make_door(settings()).role_of(asked()) is EVERYTHING
    role = make_door(settings(auth={"default_role": "v", "roles": {"v": {}}})).role_of(asked())
    assert isinstance(role, Role)
    assert role.name == "v"


def test_tokens_that_cannot_be_read(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A variable that is not set, and a file without a token, are faults with their path when the gateway starts."""
    monkeypatch.delenv("ROPEWAY_TEST_TOKEN", raising=False)
    with pytest.raises(ConfigError, match=r"gateway\.auth\.tokens\[0\]\.token\.env: .* is not set"):
        make_door(settings(auth={"tokens": [{"token": {"env": "ROPEWAY_TEST_TOKEN"}}]}))
    for content in (b"", b" \n", b"two words", b"\xff", b"x" * 5000):
        file = tmp_path / "token"
        file.write_bytes(content)
        with pytest.raises(ConfigError, match=r"gateway\.auth\.tokens\[0\]\.token\.file"):
            make_door(settings(auth={"tokens": [{"token": {"file": str(file)}}]}))


# ── gateways ───────────────────────────────────────────────────────────────────────────────────────────────────────


async def pair(stack: AsyncExitStack, token_file: Path, role: dict[str, Any], **remote: Any) -> tuple[Any, ...]:
    """A gateway that asks for a token, and one that publishes ``/x`` and ``/y`` to it."""
    here = {"name": "cloud", "graphs": ["memory:auth-there"], "listen": ["ws://127.0.0.1:0"]}
    auth = {"tokens": [{"token": {"file": str(token_file)}, "role": "robot"}], "roles": {"robot": role}}
    cloud = await stack.enter_async_context(Gateway(config.parse({"gateway": {**here, "auth": auth}})))
    address = f"ws://127.0.0.1:{cloud.servers[0].listeners[0].port}"
    items = [{"name": name, "type": STRING} for name in ("/x", "/y")]
    robot = config.parse(
        {
            "gateway": {"name": "robot", "graphs": ["memory:auth-here"], "listen": []},
            "remotes": [{"address": address, "publish": items, **remote}],
        }
    )
    return cloud, await stack.enter_async_context(Gateway(robot))


async def test_a_gateway_shows_its_token(stack: AsyncExitStack, token_file: Path) -> None:
    """A gateway as a client has the role of its token: what that allows crosses, the rest is refused and told."""
    cloud, robot = await pair(stack, token_file, {"publish": ["/x"]}, token={"file": str(token_file)})
    inboxes = {name: Inbox() for name in ("/x", "/y")}
    view = cloud.hubs["memory:auth-there"].view("reader")
    for name, inbox in inboxes.items():
        await view.create_subscription(name, STRING, None, inbox)
    here = robot.hubs["memory:auth-here"].view("writer")
    publishers = [await here.create_publisher(name, STRING) for name in ("/x", "/y")]
    await until(lambda: publishers[0].subscribers == 1)
    for publisher in publishers:
        publisher.publish(sample("hello"))
    await inboxes["/x"].wait(1)
    assert inboxes["/x"].payloads == [text("hello")]
    await until(lambda: robot.status()["routes"][1]["error"])
    assert "not allowed: role robot does not list it under publish" in robot.status()["routes"][1]["error"]
    assert not inboxes["/y"].payloads
    status = cloud.status()
    assert status["sessions"][0]["role"] == "robot"
    assert status["access"]["denied"] == {"role robot does not list it under publish": 1}
    await view.close()
    await here.close()


async def test_a_gateway_without_its_token(
    stack: AsyncExitStack, token_file: Path, caplog: pytest.LogCaptureFixture
) -> None:
    """A gateway without the token is refused with 401, which both sides tell."""
    cloud, robot = await pair(stack, token_file, {"publish": ["/x"]})
    await until(lambda: robot.status()["remotes"][0]["error"])
    assert "answered HTTP 401: a token or a certificate is needed" in robot.status()["remotes"][0]["error"]
    assert cloud.status()["access"]["refused"] == {"401 a token or a certificate is needed": 1}
    assert not any(TOKEN in line for line in caplog.messages)


async def test_tokens_in_clear(stack: AsyncExitStack, token_file: Path, caplog: pytest.LogCaptureFixture) -> None:
    """Tokens on a listener without TLS that others reach are allowed, with a warning."""
    gateway = {
        "name": "g",
        "graphs": ["memory:auth-clear"],
        "listen": ["ws://0.0.0.0:0"],
        "auth": {"tokens": [{"token": {"file": str(token_file)}}]},
    }
    await stack.enter_async_context(Gateway(config.parse({"gateway": gateway})))
    assert any("tokens are sent unencrypted" in line for line in caplog.messages)


async def test_readiness(stack: AsyncExitStack) -> None:
    """A gateway that is up is ready; one whose graphs are not says which."""
    gateway = {
        "name": "g",
        "graphs": ["memory:auth-ready"],
        "listen": ["ws://127.0.0.1:0"],
        "clients": {"path": "/ros"},
    }
    made = Gateway(config.parse({"gateway": gateway}))
    assert made.missing() == ["memory:auth-ready is not open", "0 of 1 listeners are up"]
    await stack.enter_async_context(made)
    port = made.servers[0].listeners[0].port
    assert (await fetch(port, "/readyz")).status == 200
    async with Client(port, path="/") as client:
        assert client.status.startswith("HTTP/1.1 404")
    async with Client(port, path="/ros") as client:
        assert client.status.startswith("HTTP/1.1 101")


async def test_workers_read_again(stack: AsyncExitStack, token_file: Path) -> None:
    """A supervisor has its workers read their tokens again, and adds up whom they refused."""
    port = free_port()
    settings = {
        "name": "g",
        "graphs": ["memory:auth-workers"],
        "listen": [f"ws://127.0.0.1:{port}"],
        "workers": 1,
        "auth": {"tokens": [{"token": {"file": str(token_file)}}]},
    }
    made = await stack.enter_async_context(Supervisor(config.parse({"gateway": settings})))
    async with Client(port) as client:
        assert client.status.startswith("HTTP/1.1 401")
    async with Client(port, path=f"/?token={TOKEN}") as client:
        spoil(str(token_file))
        made.reload()
        assert (await client.closed())[0] == 1008
    await until(lambda: sum(made.status()["access"].get("refused", {}).values()) == 1)


# ── certificates ───────────────────────────────────────────────────────────────────────────────────────────────────


@pytest.fixture
def ours(tmp_path: Path) -> Authority:
    return Authority(tmp_path, "ours")


def digest(certificate: str) -> str:
    """The fingerprint of a certificate."""
    return hashlib.sha256(ssl.PEM_cert_to_DER_cert(Path(certificate).read_text())).hexdigest()


def spoil(file: str) -> None:
    Path(file).write_text("junk")


def as_client(authority: Authority, own: dict[str, str] | None) -> ssl.SSLContext:
    context = ssl.create_default_context(cafile=authority.file)
    if own is not None:
        context.load_cert_chain(own["certificate"], own["key"])
    return context


async def connected(made: Gateway, context: ssl.SSLContext, path: str = "/") -> str:
    """The status of an attempt, and the role of who came in."""
    async with Client(made.servers[0].listeners[0].port, ssl_context=context, path=path) as client:
        status = client.status.split(" ")[1]
        if status != "101":
            return status
        await until(lambda: made.servers[0].sessions)
        role = next(iter(made.servers[0].sessions)).access.role.name
    await until(lambda: not made.servers[0].sessions)
    return role


async def test_certificates(stack: AsyncExitStack, ours: Authority, token_file: Path) -> None:
    """Certificates give roles; with ``optional`` a client may come with a token instead, and without either not."""
    fingerprinted = ours.sign("tablet")
    fingerprint = digest(fingerprinted["certificate"])
    gateway = {
        "name": "g",
        "graphs": ["memory:auth-certificates"],
        "listen": ["wss://127.0.0.1:0"],
        "tls": {**ours.sign("g"), "ca": ours.file, "client_certificates": "optional"},
        "auth": {
            "tokens": [{"token": {"file": str(token_file)}, "role": "person"}],
            "certificates": [
                {"common_name": "robot-*", "role": "robot"},
                {"fingerprint": fingerprint, "role": "tablet"},
            ],
            "roles": {"robot": {}, "tablet": {}, "person": {}},
        },
    }
    made = await stack.enter_async_context(Gateway(config.parse({"gateway": gateway})))
    assert await connected(made, as_client(ours, ours.sign("robot-7"))) == "robot"
    assert await connected(made, as_client(ours, fingerprinted)) == "tablet"
    assert await connected(made, as_client(ours, ours.sign("other"))) == "401"
    assert await connected(made, as_client(ours, None)) == "401"
    assert await connected(made, as_client(ours, None), f"/?token={TOKEN}") == "person"


async def presented(port: int) -> bytes | None:
    """The certificate that a server shows."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    _, writer = await asyncio.open_connection("127.0.0.1", port, ssl=context)
    shown: bytes | None = writer.get_extra_info("ssl_object").getpeercert(binary_form=True)
    writer.close()
    await writer.wait_closed()
    return shown


async def test_reload(stack: AsyncExitStack, ours: Authority, token_file: Path) -> None:
    """After a reload new connections see the new certificate and tokens; files that are no good change nothing."""
    tls = ours.sign("g")
    made, _ = await gateway(stack, "g", [], tls)
    port = int(url(made).rpartition(":")[2])
    before = await presented(port)
    ours.sign("g")  # into the same files
    assert await presented(port) == before
    made.reload()
    after = await presented(port)
    assert after != before
    spoil(tls["key"])
    with pytest.raises(ConfigError, match=r"gateway\.tls"):
        made.reload()
    assert await presented(port) == after
