"""``ros2 ropeway``: the verbs of Ropeway as a command of ``ros2``."""

import argparse
import os

from ros2cli.command import CommandExtension

from ropeway_ros.program import NotInstalled, command

__all__ = ["RopewayCommand"]


class RopewayCommand(CommandExtension):
    """Join robots and clouds that live on different networks."""

    def add_arguments(self, parser, cli_name, *, argv=None):
        """Take all that follows as the words of ``ropeway``."""
        parser.add_argument(
            "words",
            nargs=argparse.REMAINDER,
            metavar="verb ...",
            help="a verb of ropeway with its arguments: topic list -g ws://host:9090; 'help' shows them all",
        )

    def main(self, *, parser, args):
        """Become ``ropeway``."""
        words = ["--help"] if args.words in ([], ["help"]) else args.words
        try:
            found = command(*words)
        except NotInstalled as error:
            raise SystemExit(str(error)) from None
        os.execvp(found[0], found)  # noqa: S606 - it is the program that was asked for
