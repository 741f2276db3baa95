"""The command-line reference as one page of Markdown, made from the commands themselves."""

from __future__ import annotations

from collections.abc import Iterator
from enum import Enum

import typer
from typer.core import TyperArgument, TyperCommand, TyperGroup, TyperOption

from synfog_usd.cli.main import app

HEAD = """\
# Command line

Every command with its arguments and options. This page is made from the commands themselves: `python -m docs.pages`.

Exit codes: 0 done; 1 done, but something that was asked to be an error was found (`--strict`, a missed self-test);
2 refused in one line that names place and fix; 130 ended by Ctrl-C. Anything else is a fault of ours.
"""


def page() -> str:
    """All commands: a table of contents, then a section for each, in the order of the program's own help."""
    every = _commands(typer.main.get_group(app), "synfog-usd")
    commands = [(name, command) for name, command in every if not command.hidden]
    contents = ["| command | does |", "|---|---|"]
    contents += [f"| [`{name}`](#{name.replace(' ', '-')}) | {_summary(command)} |" for name, command in commands]
    sections = [line for name, command in commands for line in _section(name, command)]
    return "\n".join([HEAD, *contents, "", *sections])


def _commands(group: TyperGroup, name: str) -> Iterator[tuple[str, TyperCommand]]:
    """(name as typed, command) of all commands below a group."""
    for key, inner in group.commands.items():
        if isinstance(inner, TyperGroup):
            yield from _commands(inner, f"{name} {key}")
        elif isinstance(inner, TyperCommand):
            yield f"{name} {key}", inner


def _summary(command: TyperCommand) -> str:
    return " ".join((command.help or "").split("\n\n")[0].split())


def _section(name: str, command: TyperCommand) -> list[str]:
    arguments = [parameter for parameter in command.params if isinstance(parameter, TyperArgument)]
    options = [item for item in command.params if isinstance(item, TyperOption) and item.name != "help"]
    usage = " ".join([name, *(_placeholder(argument) for argument in arguments), *(["[OPTIONS]"] if options else [])])
    lines = [f"## {name}", "", _summary(command), "", "```sh", usage, "```", ""]
    if rows := [*map(_argument, arguments), *map(_option, options)]:
        lines += ["| argument or option | if left out | meaning |", "|---|---|---|", *rows, ""]
    return lines


def _placeholder(argument: TyperArgument) -> str:
    word = argument.name.upper()
    return word if argument.required else f"[{word}]"


def _argument(argument: TyperArgument) -> str:
    return f"| `{_placeholder(argument)}` | {'needed' if argument.required else ''} | {_cell(argument.help)} |"


def _option(option: TyperOption) -> str:
    names = ", ".join(f"`{name}`" for name in (*option.opts, *option.secondary_opts))
    return f"| {names} | {_default(option)} | {_cell(option.help)} |"


def _default(option: TyperOption) -> str:
    if option.required:
        return "needed"
    if option.default is None or option.default == () or callable(option.default):
        return ""
    if option.is_flag:
        if not option.secondary_opts:
            return "off"
        return f"`{(option.opts if option.default else option.secondary_opts)[0]}`"
    return f"`{option.default.value if isinstance(option.default, Enum) else option.default}`"


def _cell(text: str | None) -> str:
    return " ".join((text or "").split()).replace("|", "\\|")
