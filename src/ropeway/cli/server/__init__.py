"""``ropeway server``: a rosbridge server on the local network, with rosbridge's parameters as options."""

from __future__ import annotations

import logging
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer
import typer.core

from ropeway.cli.console import fail
from ropeway.cli.logs import LEVELS, set_up
from ropeway.cli.loop import run
from ropeway.cli.server.foxglove import FOXGLOVE_NODE, FOXGLOVE_PORT, foxglove_settings
from ropeway.cli.server.parameters import NODE, arguments, notes

if TYPE_CHECKING:
    from ropeway.gateway.config.config import Config

__all__ = ["app"]

app = typer.Typer(add_completion=False)
log = logging.getLogger("ropeway")

_PORT = 9090
_SAME = "As in rosbridge_websocket"
_VIEWERS = "As in foxglove_bridge, for viewers"
_ACCEPTED = "Accepted for rosbridge's sake, without effect"


class _Command(typer.core.TyperCommand):
    """Takes both spellings of rosbridge's parameters, and ROS arguments."""

    def parse_args(self, ctx: Any, args: list[str]) -> list[str]:
        options = [param for param in self.params if param.param_type_name == "option"]
        known = [name[2:] for option in options for name in option.opts if name.startswith("--")]
        flags = [option.opts[0][2:] for option in options if getattr(option, "is_flag", False)]
        return super().parse_args(ctx, arguments(args, known, flags))


def _same(help: str) -> Any:
    return typer.Option(help=help, rich_help_panel=_SAME)


def _viewers(help: str) -> Any:
    return typer.Option(help=help, rich_help_panel=_VIEWERS, show_default=False)


def _expressions(what: str) -> Any:
    return _viewers(f"Regular expressions of {what}, as \"['/a','/b.*']\".")


def _glob(what: str) -> Any:
    return _same(f"Patterns of {what}, as \"['/a','/b*']\"; '' filters nothing, '[]' allows nothing.")


_accepted = typer.Option(rich_help_panel=_ACCEPTED, show_default=False)
Accepted = Annotated[str | None, _accepted]
OptionalPath = Annotated[Path | None, typer.Option(show_default=False)]


@app.command("server", cls=_Command)
def server_command(
    port: Annotated[int | None, _same("The port; 0 takes a free one; left out: 9090, with --foxglove 8765.")] = None,
    address: Annotated[str, _same("Where to listen; left out: 127.0.0.1, this machine only.")] = "",
    url_path: Annotated[str, _same("The path of the WebSocket.")] = "/",
    certfile: Annotated[str, _same("The certificate chain, PEM; with --keyfile the server speaks wss.")] = "",
    keyfile: Annotated[str, _same("The key of the certificate, PEM.")] = "",
    retry_startup_delay: Annotated[
        float | None, _same("Seconds after which a taken port is tried again, for ever; left out: it is an error.")
    ] = None,
    websocket_ping_interval: Annotated[float, _same("Seconds between two pings; 0: as we see fit.")] = 0.0,
    websocket_ping_timeout: Annotated[float, _same("A client is disconnected after this many silent seconds.")] = 30.0,
    unregister_timeout: Annotated[float, _same("Seconds that a topic stays after its last publisher left.")] = 10.0,
    default_call_service_timeout: Annotated[float, _same("Seconds of a call that names none; 0: for ever.")] = 5.0,
    topics_glob: Annotated[str, _glob("topics, in both directions")] = "",
    topics_pub_glob: Annotated[str, _glob("topics that may be published")] = "",
    topics_sub_glob: Annotated[str, _glob("topics that may be read")] = "",
    services_glob: Annotated[str, _glob("services")] = "",
    actions_glob: Annotated[str, _glob("actions")] = "",
    params_glob: Annotated[str, _glob("parameters")] = "",
    params_timeout: Annotated[float, _same("Seconds that rosapi waits for a node.")] = 5.0,
    foxglove: Annotated[
        bool,
        typer.Option("--foxglove", help="Serve Foxglove viewers alone, in the place of foxglove_bridge."),
    ] = False,
    tls: Annotated[bool, _viewers("With --foxglove: speak TLS, with --certfile and --keyfile.")] = False,
    topic_whitelist: Annotated[str, _expressions("topics that viewers see")] = "",
    service_whitelist: Annotated[str, _expressions("services that viewers see")] = "",
    param_whitelist: Annotated[str, _expressions("parameters that viewers see, as /node.parameter")] = "",
    client_topic_whitelist: Annotated[str, _expressions("topics that viewers may publish")] = "",
    best_effort_qos_topic_whitelist: Annotated[str, _expressions("topics that are read as best effort")] = "",
    min_qos_depth: Annotated[int | None, _viewers("Messages of a topic that wait for a viewer, at least.")] = None,
    max_qos_depth: Annotated[int | None, _viewers("Messages of a topic that wait for a viewer, at most.")] = None,
    send_buffer_limit: Annotated[int | None, _viewers("Bytes of messages that wait for one viewer.")] = None,
    use_sim_time: Annotated[bool, _viewers("Viewers are told the time of /clock.")] = False,
    capabilities: Annotated[
        str, _viewers("The parts of the protocol that viewers may use, as [clientPublish,…].")
    ] = "",
    include_hidden: Annotated[bool, _viewers("Show hidden topics and services.")] = False,
    asset_uri_allowlist: Annotated[str, _expressions("files that viewers may fetch (package://…)")] = "",
    asset_roots: Annotated[
        list[Path] | None, _viewers("A directory with packages, whose files viewers may fetch; may be repeated.")
    ] = None,
    graph: Annotated[
        str, typer.Option("--graph", "-g", envvar="ROPEWAY_GRAPH", help="The network: auto, dds:0, ros2, ros1.")
    ] = "auto",
    name: Annotated[str, typer.Option(help="The name of the node.")] = NODE,
    token_file: Annotated[
        Path | None, typer.Option(help="A file with the token that clients must show.", show_default=False)
    ] = None,
    auth: Annotated[
        Path | None,
        typer.Option(help="A JSON or YAML file like gateway.auth of a configuration.", show_default=False),
    ] = None,
    origins: Annotated[
        str,
        typer.Option(
            help="Web pages that may connect beside those of this machine, as \"['https://dash.example.com']\"; "
            "'null' for files opened in a browser, '*' for all.",
            show_default=False,
        ),
    ] = "",
    hosts: Annotated[
        str,
        typer.Option(
            help="Names by which clients without a token reach this server, beside the machine's own, as "
            "\"['robot.example.com']\"; '*' for any.",
            show_default=False,
        ),
    ] = "",
    cafile: Annotated[
        str, typer.Option(help="Clients must show a certificate of these authorities, PEM.", show_default=False)
    ] = "",
    insecure: Annotated[bool, typer.Option("--insecure", help="Let other machines in without authentication.")] = False,
    max_message_bytes: Annotated[int, typer.Option(min=1024, help="A longer message closes its connection.")] = 64
    << 20,
    max_clients: Annotated[int, typer.Option(min=1, help="How many clients at a time.")] = 1000,
    types: Annotated[
        list[Path] | None, typer.Option("--types", help="More definitions: a file or a directory.", show_default=False)
    ] = None,
    for_s: Annotated[float, typer.Option("--for", min=0.0, help="End after this many seconds; 0: never.")] = 0.0,
    as_json: Annotated[bool, typer.Option("--json", help="Print the status as JSON, one line per --period.")] = False,
    period: Annotated[float, typer.Option("--period", min=0.05, help="Seconds between two lines of --json.")] = 1.0,
    log_level: Annotated[str, typer.Option("--log-level", help=f"{', '.join(LEVELS)}.")] = "info",
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="Only warnings and errors.")] = False,
    note: Annotated[list[str] | None, typer.Option(hidden=True)] = None,
    incoming_queue_size: Accepted = None,
    write_queue_size: Accepted = None,
    use_compression: Accepted = None,
    use_events_executor: Accepted = None,
    fragment_timeout: Accepted = None,
    delay_between_messages: Accepted = None,
    max_message_size: Accepted = None,
    call_services_in_new_thread: Accepted = None,
    send_action_goals_in_new_thread: Accepted = None,
    bson_only_mode: Accepted = None,
    binary_encoder: Accepted = None,
    num_threads: Accepted = None,
) -> None:
    """Serve rosbridge clients on the local network, in the place of rosbridge_websocket and rosapi.

    Options may be written with underscores, and ROS arguments (--ros-args -p port:=9091) are understood, so that
    launch files of rosbridge work. Ctrl-C and SIGTERM end it in order; SIGHUP makes it read certificates and tokens
    again. rosbridge listens on all interfaces; this server on 127.0.0.1, unless it is told another --address, which
    needs --token-file, --auth, --cafile or --insecure. Foxglove viewers are served on the same port, and with
    --foxglove on one of their own, in the place of foxglove_bridge and with its parameters.
    """
    level = set_up("warning" if quiet else log_level)
    given = _completed(dict(locals()))
    config = _config(given)
    idle = [*notes(given), *(note or ())]
    if idle:
        log.info("accepted, but without effect here: %s", "; ".join(idle))
    if not address:
        log.info("listening on 127.0.0.1 only; --address 0.0.0.0 (address:=0.0.0.0) opens it to other machines")
    from ropeway.cli.server.own import parameters_served
    from ropeway.cli.serving import Serving, serve

    delay = retry_startup_delay if retry_startup_delay and retry_startup_delay > 0 else None
    serving = Serving(
        config,
        level,
        for_s or None,
        period if as_json else None,
        retry_s=delay,
        up=_greet,
        beside=lambda gateway: parameters_served(gateway, given),
    )
    try:
        run(serve(serving))
    except KeyboardInterrupt:  # before the handler was there: nothing had been started
        return


def _completed(given: dict[str, Any]) -> dict[str, Any]:
    """Return the options with the port and the name of the server in whose place this one is."""
    viewers = given["foxglove"]
    port = given["port"] if given["port"] is not None else FOXGLOVE_PORT if viewers else _PORT
    return {**given, "port": port, "name": FOXGLOVE_NODE if viewers and given["name"] == NODE else given["name"]}


def _config(given: dict[str, Any]) -> Config:
    """Turn the options into a configuration. Raises ``ConfigError``, or ends with a sentence."""
    from ropeway.gateway.config.address import is_loopback
    from ropeway.gateway.config.config import parse
    from ropeway.gateway.config.document import read_file

    certfile, keyfile, cafile = given["certfile"], given["keyfile"], given["cafile"]
    if bool(certfile) != bool(keyfile):
        fail("--certfile and --keyfile belong together", 2)
    if cafile and not certfile:
        fail("--cafile needs --certfile and --keyfile: only wss asks clients for certificates", 2)
    for option in ("certfile", "keyfile", "cafile"):
        if given[option] and not Path(given[option]).is_file():
            fail(f"--{option}: {given[option]} is not a file", 2)
    host = given["address"] or "127.0.0.1"
    if given["foxglove"] and not given["tls"]:
        certfile = keyfile = ""  # as in foxglove_bridge
    elif given["foxglove"] and not certfile:
        fail("--tls needs --certfile and --keyfile", 2)
    scheme = ("foxglove" if given["foxglove"] else "ws") + ("s" if certfile else "")
    url = f"{scheme}://{f'[{host}]' if ':' in host else host}:{given['port']}"
    directory = Path.cwd()
    auth: Any = {}
    if given["auth"] is not None:
        auth, directory = read_file(given["auth"]), given["auth"].absolute().parent
        auth = auth["auth"] if isinstance(auth, dict) and set(auth) == {"auth"} else auth
    if given["token_file"] is not None:
        if not isinstance(auth, dict) or not isinstance(auth.get("tokens", []), list):
            fail(f"{given['auth']}: expected an object with tokens, as under gateway.auth", 2)
        token = {"token": {"file": str(given["token_file"].absolute())}}
        auth = {**auth, "tokens": [*auth.get("tokens", []), token]}
    for key in ("origins", "hosts"):
        patterns = _patterns(given[key])
        if patterns and isinstance(auth, dict):
            auth = {**auth, key: [*(auth.get(key) or ()), *patterns]}
    known = isinstance(auth, dict) and (auth.get("tokens") or auth.get("certificates"))
    if not (is_loopback(url) or known or cafile or given["insecure"]):
        fail(
            f"{url} lets in every machine that can reach it, without authentication; set a token with --token-file or "
            "--auth, or say --insecure (in a launch file: insecure:=true) if that is intended",
            2,
        )
    tls = {"certificate": certfile, "key": keyfile, **({"ca": cafile} if cafile else {})} if certfile else None
    if tls is not None:
        tls = {key: str(Path(value).absolute()) for key, value in tls.items()}
    gateway = {
        "name": given["name"],
        "graphs": [given["graph"]],
        "listen": [url],
        "insecure": given["insecure"],
        "auth": auth,
        "tls": tls,
        "globs": {key: given[key] for key in _GLOBS},
        "foxglove": foxglove_settings(given),
        "max_message_bytes": given["max_message_bytes"],
        "types": [str(path.absolute()) for path in given["types"] or ()],
        "clients": {
            "path": given["url_path"] or "/",
            "max_clients": given["max_clients"],
            "unregister_timeout_s": max(given["unregister_timeout"], 0.0),
            "call_timeout_s": max(given["default_call_service_timeout"], 0.0),
            "params_timeout_s": given["params_timeout"],
            "silence_s": given["websocket_ping_timeout"],
            **({"ping_interval_s": given["websocket_ping_interval"]} if given["websocket_ping_interval"] > 0 else {}),
        },
    }
    return parse({"gateway": gateway}, "ropeway server", directory=directory)


def _patterns(text: str) -> list[str]:
    """Return a list as rosbridge's globs are written, or with commas only."""
    return [
        part.strip().strip("'\"")
        for part in text.strip().removeprefix("[").removesuffix("]").split(",")
        if part.strip()
    ]


_GLOBS = ("topics_glob", "topics_pub_glob", "topics_sub_glob", "services_glob", "actions_glob", "params_glob")


def _greet(gateway: Any) -> None:
    status = gateway.status()
    where = ", ".join(f"{row['address'].rpartition(':')[0]}:{row['port']}" for row in status["listen"])
    graphs = [hub.graph.name for hub in gateway.hubs.values()]  # auto by what it has become
    who = "rosbridge clients" if gateway.config.gateway.listen[0].startswith("ws") else "viewers"
    log.info("%s are served at %s, on %s", who, where, ", ".join(graphs))
