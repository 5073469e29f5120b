"""Reference of the command line, generated from the Typer commands."""

import inspect
import re
from collections.abc import Iterator
from enum import Enum
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import Any, get_args, get_type_hints

import typer
from structs import cell, check_description

from bus import plugins
from outrider.cli.main import COMMANDS, make_app

_KINDS = {int: "INTEGER", float: "NUMBER", str: "TEXT", Path: "PATH"}


def page() -> str:
    """Return a section for each command: help, example, arguments and options.

    Raises:
        ValueError: If an argument or option has no help.
    """
    ours = {*COMMANDS, *extensions()}
    return "\n\n".join(
        _section(name, command)
        for name, command in commands().items()
        if not command.hidden and name.split()[0] in ours
    )


def extensions() -> dict[str, EntryPoint]:
    """Return the commands of Outrider's extensions by name, without those of other installed packages."""
    found = plugins.registered("commands").items()
    ours = {name: one for name, one in found if one.dist is None or one.dist.name == "outrider"}
    return {name.replace(".", " "): one for name, one in ours.items()}


def commands() -> dict[str, Any]:
    """Return all commands by name; subcommands follow their group."""
    found: dict[str, Any] = {}
    waiting: list[tuple[str, Any]] = [("", typer.main.get_command(make_app(whole=True)))]
    while waiting:
        name, command = waiting.pop(0)
        if name:
            found[name] = command
        inner = getattr(command, "commands", {})
        waiting[:0] = [(f"{name} {one}".strip(), inner[one]) for one in inner]
    return found


def _section(name: str, command: Any) -> str:
    prose, _, example = inspect.cleandoc(command.help or "").partition("Example:")
    types = get_type_hints(inspect.unwrap(command.callback))
    shown = [one for one in command.params if not getattr(one, "hidden", False)]
    arguments = "".join(f" {_argument(one)}" for one in shown if _is_argument(one))
    lines = [f"## outrider {name}", prose.strip(), f"Usage: `outrider {name} [OPTIONS]{arguments}`"]
    if example.strip():
        flat = " ".join(example.split())
        shell = re.sub(r",? (?:then|or|and) (?=outrider )| Example: ", "\n", flat)
        lines.append(f"```sh\n{shell}\n```")
    for one in shown:
        check_description(f"outrider {name}, {one.name}", one.help or "", quantity=False)
    rows = [_row(one, types.get(one.name, str)) for one in shown]
    if rows:
        lines.append("\n".join(["| option | description | default |", "|---|---|---|", *rows]))
    return "\n\n".join(lines)


def _is_argument(parameter: Any) -> bool:
    return not any(name.startswith("-") for name in parameter.opts)


def _argument(parameter: Any) -> str:
    name = str(parameter.metavar or parameter.name).upper()
    return name if parameter.required else f"[{name}]"


def _row(parameter: Any, type_: Any) -> str:
    if _is_argument(parameter):
        names = f"`{_argument(parameter)}`"
    else:
        names = ", ".join(f"`{name}`" for name in (*parameter.opts, *parameter.secondary_opts))
        names += "".join(f" {kind}" for kind in _kinds(parameter, type_))
    text = " ".join((parameter.help or "").split())
    variables = parameter.envvar if isinstance(parameter.envvar, list) else [parameter.envvar]
    named = ", ".join(f"`{variable}`" for variable in variables if variable)
    text += f" Environment variable: {named}." if named else ""
    return f"| {names} | {cell(_without_links(text))} | {_default(parameter)} |"


def _kinds(parameter: Any, type_: Any) -> Iterator[str]:
    """Yield the placeholder after an option's name, if it has a value."""
    parts = [part for part in (type_, *get_args(type_)) if isinstance(part, type)]
    plain = next((part for part in parts if part not in (type(None), list, tuple)), str)
    if parameter.metavar:
        yield " or ".join(f"`{one}`" for one in parameter.metavar.split("|"))
    elif issubclass(plain, Enum):
        yield " or ".join(f"`{one.value}`" for one in plain)
    elif plain is not bool:
        yield _KINDS.get(plain, "TEXT")


def _default(parameter: Any) -> str:
    if parameter.required:
        return "required"
    value = parameter.default
    if value is None or callable(value) or value in ((), [], "", False):
        return ""
    return f"`{getattr(value, 'value', value)}`"


def _without_links(text: str) -> str:
    """Return the text with square brackets escaped outside code."""
    parts = re.split(r"(`[^`]*`)", text)
    return "".join(p if p.startswith("`") else re.sub(r"([\[\]])", r"\\\1", p) for p in parts)
