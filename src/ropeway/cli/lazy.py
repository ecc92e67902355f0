"""A group of verbs of which only the one in use is imported, so that the command starts fast."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from difflib import get_close_matches
from typing import Any

import typer
import typer.core
import typer.main

from ropeway.cli.credentials import add_credentials
from ropeway.extras import needing

__all__ = ["lazy_group"]


def lazy_group(verbs: Mapping[str, str]) -> type[typer.core.TyperGroup]:
    """Make a group class whose verbs are ``{name: module}``; each module has its ``typer.Typer`` as ``app``."""

    class LazyGroup(typer.core.TyperGroup):
        def list_commands(self, ctx: Any) -> list[str]:
            return list(verbs)

        def get_command(self, ctx: Any, cmd_name: str) -> Any:
            if cmd_name not in verbs:
                return None
            known = self.commands.get(cmd_name)
            if known is None:
                with needing(f"ropeway {ctx.command_path.partition(' ')[2]} {cmd_name}".replace("  ", " ")):
                    module = importlib.import_module(verbs[cmd_name])
                known = self.commands[cmd_name] = typer.main.get_command(module.app)
                add_credentials(known)
                _plain_flags(known, ctx)
            return known

        def resolve_command(self, ctx: Any, args: list[str]) -> Any:
            if args and args[0] in verbs:
                return super().resolve_command(ctx, args)
            near = get_close_matches(args[0], verbs) if args and not args[0].startswith("-") else []
            if near:
                ctx.fail(f"No such command {args[0]!r}. Did you mean {' or '.join(near)}?")
            return super().resolve_command(ctx, args)

        def get_params(self, ctx: Any) -> Any:
            _plain_flags(self, ctx)
            return super().get_params(ctx)

    return LazyGroup


def _plain_flags(command: Any, ctx: Any) -> None:
    """Show flags without a type in the help: they take no value, and ``--json <bool>`` looks as if they did."""
    for param in (*command.params, command.get_help_option(ctx)):
        if getattr(param, "is_flag", False):
            param.metavar = ""
    for below in getattr(command, "commands", {}).values():
        _plain_flags(below, ctx)
