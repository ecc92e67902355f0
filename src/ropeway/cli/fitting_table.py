"""Tables for terminals of any width: where it is too narrow for all columns, some are left out."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from typing import Final

from rich.console import Console, ConsoleOptions, RenderResult
from rich.table import Table
from rich.text import Text

__all__ = ["FittingTable", "print_table"]

_GAP: Final = 1  # characters between two columns
_PIPE_COLUMNS: Final = 240  # where there is no terminal, nothing is left out


class FittingTable:
    """A table that leaves out columns where the terminal is too narrow for all of them.

    Columns of ``dispensable`` give way, the first of them first: a figure without its last digits is a lie. Columns of
    ``text`` are set flush left. Cells may have rich's markup.
    """

    def __init__(
        self, title: str, *columns: str, dispensable: Sequence[str] = (), text: Collection[str] = ("topic",)
    ) -> None:
        self._title, self._columns = title, columns
        self._dispensable, self._text = dispensable, text
        self._rows: list[tuple[str, ...]] = []

    def add_row(self, *cells: str) -> None:
        """Add a row with a cell for each column."""
        self._rows.append(cells)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render the columns that fit."""
        shown = self.fitting(options.max_width)
        table = Table(title=self._title, title_justify="left", box=None, pad_edge=False, header_style="bold")
        table.padding = (0, _GAP, 0, 0)
        for name in shown:
            justify = "left" if name in self._text else "right"
            table.add_column(name, justify=justify, no_wrap=True, overflow="ellipsis")  # type: ignore[arg-type]
        for row in self._rows:
            table.add_row(*(cell for name, cell in zip(self._columns, row, strict=True) if name in shown))
        yield table

    def fitting(self, width: int) -> list[str]:
        """Return the names of the columns that fit into so many characters."""
        needed = {
            name: max(len(name), *(Text.from_markup(row[index]).cell_len for row in self._rows), 0)
            for index, name in enumerate(self._columns)
        }
        for name in self._dispensable:
            if sum(needed.values()) + _GAP * len(needed) <= width:
                break
            needed.pop(name, None)
        return list(needed)


def print_table(table: FittingTable) -> None:
    """Print a table as wide as the terminal, and whole into a pipe."""
    console = Console()
    if not console.is_terminal:
        console = Console(width=_PIPE_COLUMNS)
    console.print(table)
