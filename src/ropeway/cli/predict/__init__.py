"""``ropeway predict``: which rates and delays links will allow, before anything runs."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from ropeway.cli.console import complain, fail, print_json
from ropeway.cli.session import JsonOption, TypesOption

__all__ = ["app"]

app = typer.Typer(add_completion=False)


@app.command("predict")
def predict_command(
    file: Annotated[
        Path | None,
        typer.Argument(help="A gateway's configuration or a plan, JSON or YAML.", show_default=False),
    ] = None,
    part: Annotated[
        str, typer.Option("--as", help="One of several gateways in FILE; all of them without.", show_default=False)
    ] = "",
    topic: Annotated[
        list[str] | None,
        typer.Option(
            "--topic",
            "-t",
            help="A topic: NAME,bytes=N,hz=N, and if wanted from=HOST, to=HOST:READERS, ratio=N. Of a recording or a "
            "network its name is enough.",
            show_default=False,
        ),
    ] = None,
    hosts: Annotated[str, typer.Option("--hosts", help="Who sends, and who receives.")] = "robot,cloud",
    mbit: Annotated[
        float, typer.Option("--mbit", min=0.0, help="What the link carries each way, in Mbit/s.", show_default=False)
    ] = 0.0,
    delay_ms: Annotated[float, typer.Option("--delay-ms", min=0.0, help="Its delay one way.")] = 0.0,
    shared: Annotated[bool, typer.Option("--shared", help="Both ways share the rate, as on Wi-Fi.")] = False,
    readers: Annotated[int, typer.Option("--readers", min=1, help="Readers per topic on the receiving host.")] = 1,
    bag: Annotated[Path | None, typer.Option("--bag", help="Measure a recording.", show_default=False)] = None,
    graph: Annotated[
        str, typer.Option("--graph", "-g", help="Measure a network, such as dds:0.", show_default=False)
    ] = "",
    seconds: Annotated[float, typer.Option("--seconds", min=0.5, help="How long to measure.")] = 5.0,
    types: TypesOption = None,
    encoding: Annotated[
        list[str] | None,
        typer.Option("--encoding", "-e", help="dds, none, cbor, cbor-raw, zip, rawzip or zstd.", show_default=False),
    ] = None,
    plot: Annotated[
        Path | None, typer.Option("--plot", help="Draw the rates to this PNG file.", show_default=False)
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Predict at which rate and delay topics arrive: with plain DDS, and with gateways by encoding.

    What crosses is told by FILE, by --topic, or measured with --bag or --graph. The exit status is 1 where a topic
    will not arrive at the rate at which it is published.
    """
    from ropeway.cli.predict.chart import draw
    from ropeway.cli.predict.sources import PredictionInput, chosen_encodings, gather
    from ropeway.cli.predict.tables import print_tables
    from ropeway.planning.prediction import CONFIGURED, predict

    told = PredictionInput(file, topic or [], hosts, mbit, delay_ms / 1e3, not shared, readers, part)
    plan, left_out = gather(told, bag=bag, graph=graph, seconds=seconds, types=types)
    for path in left_out:
        complain(f"{path} is left out: nothing says how large and frequent its messages are, or what its link carries")
    rows = predict(plan, chosen_encodings(encoding or [], plan))
    if not rows:
        fail("there is no topic to predict; name some with --topic, or measure them with --bag or --graph", 2)
    if as_json:
        print_json({"predictions": [row.to_json() for row in rows], "left_out": left_out})
    else:
        print_tables(rows)
    if plot is not None and not draw(rows, plot):
        fail("drawing needs an extra: pip install 'ropeway[demo]'")
    wanted = [row for row in rows if row.encoding == CONFIGURED] or rows
    if any(row.shared_hz < row.published_hz for row in wanted):
        raise typer.Exit(1)
