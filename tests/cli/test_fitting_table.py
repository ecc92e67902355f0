"""Tables fit the terminal."""

from __future__ import annotations

import os

import pytest
from rich.console import Console

from ropeway.cli.fitting_table import FittingTable, print_table

GIVE_WAY = ("encoding", "p99 ms", "drops", "Mb/s", "way", "arrived")


def test_narrow_tables_leave_out_columns() -> None:
    """A terminal that is too narrow costs columns, and no digit of a figure."""
    table = FittingTable("T", "topic", "way", "arrived", "Hz", "p99 ms", "encoding", dispensable=GIVE_WAY)
    table.add_row("/camera/color/image_raw", "→ cloud", "449/450", "73.25", "12.75", "zstd")
    assert table.fitting(80) == ["topic", "way", "arrived", "Hz", "p99 ms", "encoding"]
    assert table.fitting(50) == ["topic", "way", "arrived", "Hz"]
    assert table.fitting(30) == ["topic", "Hz"]
    for width in range(31, 81):
        console = Console(width=width, record=True, file=open(os.devnull, "w"))  # noqa: SIM115, PTH123
        console.print(table)
        console.file.close()
        assert "73.25" in console.export_text()


def test_markup_takes_no_room() -> None:
    """Colours count for nothing in the width of a column."""
    table = FittingTable("T", "topic", "Hz", dispensable=("Hz",))
    table.add_row("/a", "[red]8.19[/red]")
    assert table.fitting(11) == ["topic", "Hz"]


def test_a_table_without_rows() -> None:
    """A table without rows has its heads."""
    assert FittingTable("T", "topic", "Hz").fitting(3) == ["topic", "Hz"]


def test_pipes_get_all_columns(capsys: pytest.CaptureFixture[str]) -> None:
    """Where the output is no terminal, every column is there, however wide."""
    table = FittingTable("T", "topic", "Hz", dispensable=("Hz",))
    table.add_row("/a" * 50, "8.19")
    print_table(table)
    assert "8.19" in capsys.readouterr().out
