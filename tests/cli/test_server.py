"""``ropeway server``: rosbridge's options and ROS arguments, what they come to, and the server as a process."""

from __future__ import annotations

import asyncio
import json
import os
import signal
import subprocess
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
import typer

from ropeway.cli.server import _completed, _config, app
from ropeway.cli.server.own import declared, declared_to_viewers
from ropeway.cli.server.parameters import WITHOUT_EFFECT, arguments, notes
from ropeway.cli.server.rosargs import split
from ropeway.errors import ConfigError
from ropeway.gateway.config.config import Config
from tests.cli.conftest import Ropeway
from tests.support.authority import Authority
from tests.support.until import PATIENCE_S
from tests.support.websocket import Client, fetch

Start = Callable[..., subprocess.Popen[str]]

ROSBRIDGE = (
    *("port", "address", "url_path", "retry_startup_delay", "certfile", "keyfile", "websocket_ping_interval"),
    *("websocket_ping_timeout", "incoming_queue_size", "write_queue_size", "use_compression", "use_events_executor"),
    *("fragment_timeout", "delay_between_messages", "max_message_size", "unregister_timeout", "topics_glob"),
    *("topics_pub_glob", "topics_sub_glob", "services_glob", "actions_glob", "call_services_in_new_thread"),
    *("default_call_service_timeout", "send_action_goals_in_new_thread", "params_glob", "params_timeout"),
    *("bson_only_mode", "binary_encoder"),
)


MEMORY = ("--graph", "memory:server")


# ── ROS arguments ──────────────────────────────────────────────────────────────────────────────────────────────────


def test_ros_arguments(tmp_path: Path) -> None:
    """Parameters, files, names and levels of ROS arguments are understood; what a node is not meant by is left out."""
    file = tmp_path / "params.yaml"
    file.write_text(
        "/**:\n  ros__parameters: {port: 1, address: ''}\n"
        "/**/rb:\n  ros__parameters: {port: 2, qos: {depth: 5}}\n"
        "rb:\n  ros__parameters: {port: 5}\n"
        "/ns:\n  rb:\n    ros__parameters: {keyfile: k}\n"
        "/*/rb:\n  ros__parameters: {url_path: /x}\n"
        "other:\n  ros__parameters: {port: 3}\n"
    )
    others, said = split(
        [
            *("--a", "--ros-args", "-r", "__node:=rb", "--params-file", str(file), "-p", "certfile:=c"),
            *("-p", "other:port:=4", "-r", "rosbridge_websocket:__ns:=/ns", "--log-level", "warn"),
            *("--log-level", "rcl:=debug", "-r", "/a:=/b", "--disable-rosout-logs", "-e", "enclave", "--", "b"),
            *("--ros-args", "-p", "rb:topics_glob:=['/a','b']"),
        ],
        "rosbridge_websocket",
    )
    assert others == ["--a", "b"]
    assert (said.full_name, said.log_level) == ("/ns/rb", "warning")
    assert said.parameters == {
        "port": 2,
        "address": "",
        "keyfile": "k",
        "url_path": "/x",
        "certfile": "c",
        "topics_glob": ["/a", "b"],
        "qos.depth": 5,
    }
    assert len(said.notes) == 3


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("", "no ros__parameters stand in it; expected /bridges/rb"),
        ("port: 9091\n", "no ros__parameters stand in it"),
        ("rb: {port: 9091}\n", "no ros__parameters stand in it"),
        ("rb: {ros__parameters: }\n", "expected an object with parameters"),
        ("ros__parameters: {port: 9091}\n", "it stands below no node"),
        ("rb: {ros__parameters: {port: 9091}}\n", "it has parameters of /rb, and none of /bridges/rb"),
        ("/*: {ros__parameters: {port: 9091}}\n/camera: {ros__parameters: {a: 1}}", r"of /\*, /camera, and none of"),
    ],
)
def test_parameter_files_that_say_nothing_to_us(tmp_path: Path, text: str, why: str) -> None:
    """A parameter file that would be ignored is an error that says why."""
    file = tmp_path / "params.yaml"
    file.write_text(text)
    with pytest.raises(ConfigError, match=why):
        split(["--ros-args", "-r", "__ns:=/bridges", "--params-file", str(file)], "rb")


@pytest.mark.parametrize("pattern", ["/**", "**", "/**/rb", "/*/rb", "/bridges/*", "/bridges/rb", "bridges/rb", "/*/*"])
def test_patterns_of_parameter_files(tmp_path: Path, pattern: str) -> None:
    """A key names nodes by wildcards and namespaces as in ROS 2."""
    file = tmp_path / "params.yaml"
    file.write_text(f'"{pattern}":\n  ros__parameters: {{port: 9091}}\n')
    _, said = split(["--ros-args", "-r", "__ns:=/bridges", "--params-file", str(file)], "rb")
    assert said.parameters == {"port": 9091}


@pytest.mark.parametrize(("word", "there"), [("true", True), ("yes", True), ("off", False), ("'on'", True)])
def test_switches_of_parameters(word: str, there: bool) -> None:
    """A switch takes every word that ROS 2 takes for a bool, and no other."""
    made = arguments(["--ros-args", "-p", f"insecure:={word}"], ["insecure"], ["insecure"])
    assert ("--insecure" in made) is there
    with pytest.raises(ConfigError, match="expected true or false"):
        arguments(["--ros-args", "-p", "insecure:=maybe"], ["insecure"], ["insecure"])


@pytest.mark.parametrize(
    "given", [["-p"], ["-p", "port"], ["-r", "x"], ["--nonsense"], ["--params-file", "/none"], ["-p", "a:={"]]
)
def test_malformed_ros_arguments(given: list[str]) -> None:
    """What is malformed is refused with what it was."""
    with pytest.raises(ConfigError):
        split(["--ros-args", *given], "node")


def test_spellings() -> None:
    """Options have dashes or underscores; parameters become options; switches take a value or none."""
    known = [name.replace("_", "-") for name in (*ROSBRIDGE, "insecure", "name")]
    made = arguments(
        [
            *("--unregister_timeout", "3", "--max_message_size=5", "--bson_only_mode", "--use_compression", "false"),
            *("--ros-args", "-p", "port:=9091", "-p", "insecure:=true", "-p", "x_y:=1", "-p", "address:=''"),
            *("-p", "services_glob:=['/a', '/b']", "-p", "use_sim_time:=false", "-r", "__node:=rb"),
        ],
        known,
        ["insecure"],
    )
    assert made == [
        "--unregister-timeout",
        "3",
        "--max-message-size=5",
        "--bson-only-mode",
        "true",
        "--use-compression",
        "false",
        "--name=rb",
        "--port=9091",
        "--insecure",
        "--services-glob=['/a','/b']",
        "--note=the parameter x_y (rosbridge has none of this name)",
    ]


def test_every_parameter_is_an_option() -> None:
    """Every parameter of rosbridge, in whatever version, is an option here, in both spellings."""
    command = typer.main.get_command(app)
    options = {name for param in command.params for name in param.opts}
    assert {"--" + name.replace("_", "-") for name in ROSBRIDGE} <= options
    assert WITHOUT_EFFECT.keys() <= set(ROSBRIDGE)


def test_notes() -> None:
    """What has no effect here is named with the reason, unless it says nothing but the default."""
    assert notes({"use_compression": "false", "max_message_size": "10000000", "bson_only_mode": None}) == []
    told = notes({"use_compression": "true", "max_message_size": "1000"})
    assert [note.partition(" (")[0] for note in told] == ["use_compression", "max_message_size"]


# ── what they come to ──────────────────────────────────────────────────────────────────────────────────────────────


def configured(*given: str) -> Config:
    """The configuration of a command line."""
    command = typer.main.get_command(app)
    context = command.make_context("server", list(given))
    return _config(_completed(context.params))


def test_defaults() -> None:
    """Without options the server listens on this machine only, at rosbridge's port, on whatever network there is."""
    gateway = configured().gateway
    assert gateway.listen == ("ws://127.0.0.1:9090",)
    assert (gateway.name, gateway.graphs) == ("rosbridge_websocket", ("auto",))
    assert gateway.clients.unregister_timeout_s == 10.0
    assert gateway.globs.topics is None
    assert not gateway.insecure


def test_values() -> None:
    """Values of rosbridge's parameters come where they belong."""
    gateway = configured(
        *("--port", "1234", "--address", "::1", "--url_path", "/ros", "--unregister-timeout", "0.5"),
        *("--topics_glob", "['/a']", "--actions_glob", "[]", "--graph", "memory:x", "--name", "rb"),
        *("--default_call_service_timeout", "-1", "--websocket_ping_interval", "7", "--websocket_ping_timeout", "9"),
    ).gateway
    assert gateway.listen == ("ws://[::1]:1234",)
    assert (gateway.clients.path, gateway.clients.unregister_timeout_s) == ("/ros", 0.5)
    assert (gateway.clients.call_timeout_s, gateway.clients.ping_interval_s, gateway.clients.silence_s) == (0, 7, 9)
    assert (gateway.globs.topics, gateway.globs.actions, gateway.globs.services) == (("/a",), (), None)


def test_authentication(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Other machines come in with a token, a file of roles or ``--insecure``; paths start where they stand."""
    monkeypatch.chdir(tmp_path)
    Path("token").write_text("t")
    Path("more").mkdir()
    Path("more/other").write_text("o")
    Path("more/auth.yaml").write_text("auth: {tokens: [{token: {file: other}, role: v}], roles: {v: {}}}")
    everywhere = ("--address", "0.0.0.0")
    assert configured(*everywhere, "--insecure").gateway.insecure
    auth = configured(*everywhere, "--token-file", "token", "--auth", "more/auth.yaml").gateway.auth
    assert [item.token.file for item in auth.tokens if item.token] == [
        str(tmp_path / "more/other"),
        str(tmp_path / "token"),
    ]
    for wrong in (everywhere, ("--certfile", "token"), ("--cafile", "token"), ("--certfile", "x", "--keyfile", "y")):
        with pytest.raises(typer.Exit) as ended:
            configured(*wrong)
        assert ended.value.exit_code == 2
    with pytest.raises(ConfigError, match=r"gateway\.globs"):
        configured("--topics_glob", "/a")


def test_tls(tmp_path: Path) -> None:
    """With certificate and key the server speaks wss."""
    files = Authority(tmp_path, "ours").sign("server")
    gateway = configured("--certfile", files["certificate"], "--keyfile", files["key"]).gateway
    assert gateway.listen == ("wss://127.0.0.1:9090",)
    assert gateway.tls is not None


# ── as a process ───────────────────────────────────────────────────────────────────────────────────────────────────


def first(process: subprocess.Popen[str]) -> Any:
    assert process.stdout is not None
    return json.loads(process.stdout.readline())


async def test_serves(background: Start, environment: dict[str, str], tmp_path: Path) -> None:
    """The server answers HTTP and calls, lets in who has the token, and ends in order on a signal."""
    token = tmp_path / "token"
    token.write_text("secret")
    process = background(
        *("server", "--port", "0", "--token-file", str(token), "--json", "--period", "0.1"),
        *("--ros-args", "-p", "call_services_in_new_thread:=true", "-r", "__node:=rb", "--"),
    )
    status = await asyncio.to_thread(first, process)
    assert status["name"] == "rb"
    port = status["listen"][0]["port"]
    assert (await fetch(port, "/readyz")).status == 200
    async with Client(port) as client:
        assert client.status.startswith("HTTP/1.1 401")
    async with Client(port, path="/?token=secret") as client:
        client.send({"op": "call_service", "service": "/rosapi/get_time", "id": "1"})
        assert (await client.json())["result"] is True
        token.write_text("another")
        process.send_signal(signal.SIGHUP)
        assert (await client.closed())[0] == 1008
    process.send_signal(signal.SIGINT)
    _, err = await asyncio.to_thread(process.communicate, timeout=10)
    assert process.returncode == 0
    assert err.rstrip().endswith("rb has ended")
    assert "listening on 127.0.0.1 only" in err
    assert "has read its certificates and tokens again" in err
    assert "secret" not in err


def test_retries_a_taken_port(background: Start, ropeway: Ropeway) -> None:
    """A port that is taken is an error at once, or is tried again where rosbridge's delay is given."""
    holder = background("server", *MEMORY, "--port", "0", "--json", "--period", "0.1")
    port = first(holder)["listen"][0]["port"]
    failed = ropeway("server", *MEMORY, "--port", str(port))
    assert failed.returncode == 1
    assert "cannot listen" in failed.stderr
    waiting = background(
        "server", *MEMORY, "--port", str(port), "--retry_startup_delay", "0.2", "--json", "--period", "0.1"
    )
    assert waiting.stderr is not None
    while "trying again in 0.2 s" not in waiting.stderr.readline():
        pass
    holder.terminate()
    holder.communicate(timeout=PATIENCE_S)
    assert first(waiting)["listen"][0]["port"] == port


def test_notes_are_one_line(ropeway: Ropeway) -> None:
    """Whatever has no effect here is accepted with one line in the log."""
    result = ropeway(
        "server", *MEMORY, "--port", "0", "--for", "0.1", "--use_compression", "--max_message_size", "1000"
    )
    assert result.returncode == 0, result.stderr
    lines = [line for line in result.stderr.splitlines() if "without effect" in line]
    assert len(lines) == 1
    assert "use_compression" in lines[0]
    assert "max_message_size" in lines[0]


# ── its parameters ─────────────────────────────────────────────────────────────────────────────────────────────────


def test_parameters_of_the_node() -> None:
    """Every parameter of rosbridge is there in its type, and the port that was taken."""
    given = dict.fromkeys(WITHOUT_EFFECT) | {
        **dict.fromkeys(("address", "url_path", "certfile", "keyfile", "topics_glob", "topics_pub_glob"), ""),
        **dict.fromkeys(("topics_sub_glob", "services_glob", "actions_glob", "params_glob"), ""),
        **dict.fromkeys(("websocket_ping_interval", "unregister_timeout", "default_call_service_timeout"), 5.0),
        "port": 0,
        "websocket_ping_timeout": 30.0,
        "params_timeout": 5.0,
        "retry_startup_delay": None,
        "bson_only_mode": "true",
    }
    found = {parameter.name: parameter.value for parameter in declared(given, 41234)}
    assert set(found) == {*ROSBRIDGE, "actual_port", "use_sim_time"}
    assert (found["port"], found["actual_port"], found["address"]) == (0, 41234, "127.0.0.1")
    assert (found["bson_only_mode"], found["use_compression"], found["fragment_timeout"]) == (True, False, 600)


def test_parameters_over_dds(background: Start, ropeway: Ropeway) -> None:
    """``param`` finds the parameters of a server that runs, and is told why none can be set."""
    domain = ("--graph", f"dds:{os.environ.get('ROS_DOMAIN_ID', '') or 90 + os.getpid() % 20}")
    server = background("server", *domain, "--port", "0", "--json", "--period", "0.2", "--name", "bridge")
    assert server.stdout is not None
    port = json.loads(server.stdout.readline())["listen"][0]["port"]
    assert ropeway("param", "get", "/bridge", "actual_port", *domain).stdout == f"Integer value is: {port}\n"
    assert "  actual_port\n  address\n" in ropeway("param", "list", "/bridge", *domain).stdout
    refused = ropeway("param", "set", "/bridge", "port", "1", *domain)
    assert refused.returncode == 1
    assert "port is read-only while /bridge runs: start the server with --port" in refused.stderr


# ── in the place of foxglove_bridge ────────────────────────────────────────────────────────────────────────────────

FOXGLOVE = (
    *("port", "address", "tls", "certfile", "keyfile", "topic_whitelist", "service_whitelist", "param_whitelist"),
    *("client_topic_whitelist", "best_effort_qos_topic_whitelist", "min_qos_depth", "max_qos_depth"),
    *("send_buffer_limit", "use_sim_time", "capabilities", "include_hidden", "asset_uri_allowlist", "num_threads"),
)


def as_launched(*given: str) -> Config:
    """The configuration of a command line with ROS arguments."""
    command = typer.main.get_command(app)
    context = command.make_context("server", ["--foxglove", *given])
    return _config(_completed(context.params))


def test_every_parameter_of_foxglove_bridge_is_an_option() -> None:
    """Every parameter of foxglove_bridge is an option here."""
    command = typer.main.get_command(app)
    options = {name for param in command.params for name in param.opts}
    assert {"--" + name.replace("_", "-") for name in FOXGLOVE} <= options


def test_in_the_place_of_foxglove_bridge(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The parameters of foxglove_bridge's launch file mean what they mean there."""
    (tmp_path / "share").mkdir()
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}:{tmp_path}/missing")
    gateway = as_launched(
        *("--insecure", "--ros-args", "-p", "port:=8766", "-p", "address:=0.0.0.0", "-p", "tls:=false"),
        *("-p", "topic_whitelist:=['/a.*','/it{1,2}']", "-p", r"asset_uri_allowlist:=['^package://.*\.stl$']"),
        *("-p", "max_qos_depth:=10", "-p", "send_buffer_limit:=1000", "-p", "use_sim_time:=true"),
        *("-p", "capabilities:=[clientPublish,services]", "-p", "include_hidden:=true", "-p", "num_threads:=4"),
        *("-p", "best_effort_qos_topic_whitelist:=['(?!)']", "-p", "certfile:=", "-p", "sysinfo:=true"),
    ).gateway
    assert (gateway.name, gateway.listen) == ("foxglove_bridge", ("foxglove://0.0.0.0:8766",))
    settings = gateway.foxglove
    assert settings.topic_whitelist == ("/a.*", "/it{1,2}")
    assert settings.asset_uri_allowlist == (r"^package://.*\.stl$",)
    assert settings.asset_roots == (str(tmp_path / "share"),)
    assert (settings.max_qos_depth, settings.send_buffer_limit, settings.use_sim_time) == (10, 1000, True)
    assert (settings.capabilities, settings.include_hidden) == (("clientPublish", "services"), True)
    assert as_launched().gateway.listen == ("foxglove://127.0.0.1:8765",)
    assert as_launched().gateway.foxglove.asset_roots == ()


def test_tls_of_viewers(tmp_path: Path) -> None:
    """The certificate counts where ``tls`` is true, as in foxglove_bridge."""
    files = Authority(tmp_path, "ours").sign("server")
    given = ("--certfile", files["certificate"], "--keyfile", files["key"])
    assert as_launched("--tls", *given).gateway.listen == ("foxgloves://127.0.0.1:8765",)
    assert as_launched(*given).gateway.listen == ("foxglove://127.0.0.1:8765",)
    with pytest.raises(typer.Exit):
        as_launched("--tls")
    with pytest.raises(ConfigError, match="topic_whitelist"):
        as_launched("--topic-whitelist", "['(']")


async def test_serves_viewers(background: Start) -> None:
    """The server serves viewers as a process, tells what has no effect in one line, and ends in order."""
    process = background(
        *("server", *MEMORY, "--foxglove", "--port", "0", "--json", "--period", "0.1", "--num-threads", "4"),
        *("--ros-args", "-p", "message_backlog_size:=5", "--"),
    )
    status = await asyncio.to_thread(first, process)
    async with Client(status["listen"][0]["port"], subprotocol="foxglove.sdk.v1") as viewer:
        assert (await viewer.json())["op"] == "serverInfo"
    process.send_signal(signal.SIGINT)
    _, err = await asyncio.to_thread(process.communicate, timeout=10)
    assert process.returncode == 0
    (line,) = [line for line in err.splitlines() if "without effect" in line]
    assert "num_threads" in line
    assert "message_backlog_size" in line


def test_parameters_of_the_node_of_viewers() -> None:
    """The parameters of foxglove_bridge are there in their types, and ``port`` is the one that was taken."""
    given = {"address": "", "tls": False, "certfile": "", "keyfile": ""}
    found = {each.name: each.value for each in declared_to_viewers(as_launched().gateway.foxglove, given, 41234)}
    assert (found["port"], found["address"], found["tls"]) == (41234, "127.0.0.1", False)
    assert found["topic_whitelist"] == [".*"]
    assert {type(value) for value in found.values()} <= {int, bool, str, list}
