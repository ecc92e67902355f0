"""``python -m ropeway``: the command line."""

from ropeway.cli import main

main()
