"""Reference of the bus, from its table of keys and its messages."""

import msgspec
from structs import cell, fields, structs, text_of, words

from bus.keys import KEYS, Role
from bus.messages.base import Message


def keys() -> str:
    """Return the table of keys."""
    rows = [
        "| key | message | written by | read by | delivery | largest |",
        "|---|---|---|---|---|--:|",
    ]
    for key in KEYS:
        vehicle = {Role.UAV: "<uav>", Role.UGV: "<ugv>"}.get(key.vehicle or Role.SIMULATOR, "")
        message = key.message.__name__
        readers = ", ".join(key.readers)
        rows.append(
            f"| `{key.expression('<run>', vehicle)}` | [{message}](#{message.lower()}) | {key.writer} "
            f"| {readers} | {key.delivery} | {key.largest >> 10} KiB |"
        )
    return "\n".join(rows)


def messages() -> str:
    """Return a section for each message and each struct inside one."""
    found: dict[type[msgspec.Struct], None] = {}
    waiting: list[type[msgspec.Struct]] = [key.message for key in KEYS]
    while waiting:
        one = waiting.pop(0)
        if one not in found:
            found[one] = None
            waiting += [inner for field in fields(one) for inner in structs(field.type)]
    links: dict[type, str] = {one: f"#{one.__name__.lower()}" for one in found}
    return "\n\n".join(_section(one, links) for one in found)


def _section(struct: type[msgspec.Struct], links: dict[type, str]) -> str:
    rows = ["| field | type | default | description |", "|---|---|---|---|"]
    for field in fields(struct):
        default = f"`{field.default}`" if field.default else ""
        type_text = words(field.type, links=links)
        rows.append(
            f"| `{field.name}` | {cell(type_text)} | {cell(default)} | {cell(field.text)} |"
        )
    level = "###" if issubclass(struct, Message) else "####"
    return f"{level} {struct.__name__}\n\n{text_of(struct)}\n\n" + "\n".join(rows)
