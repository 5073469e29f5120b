"""Fields of our msgspec structs as text: types with limits, defaults, and descriptions."""

import inspect
import textwrap
from collections.abc import Iterator
from typing import Any, NamedTuple

import msgspec
from msgspec import inspect as types
from scenario_schema import field_docs


class Field(NamedTuple):
    """Field of a struct, as a row of a table."""

    name: str
    type: types.Type
    default: str
    """Default in Python notation; empty for a required field."""
    text: str


def text_of(struct: type[msgspec.Struct]) -> str:
    """Return the docstring of a struct, unwrapped."""
    return " ".join(textwrap.dedent(inspect.getdoc(struct) or "").split())


def fields(struct: type[msgspec.Struct]) -> Iterator[Field]:
    """Yield all fields, in order."""
    info = types.type_info(struct)
    if not isinstance(info, types.StructType):
        raise TypeError(f"{struct} is not a struct")
    texts = field_docs(struct)
    for field in info.fields:
        default = "" if field.required else _default(field)
        yield Field(field.encode_name, field.type, default, texts.get(field.name, ""))


def structs(type_: types.Type) -> Iterator[type[msgspec.Struct]]:
    """Yield the structs inside a type."""
    if isinstance(type_, types.StructType):
        yield type_.cls
    for part in _parts(type_):
        yield from structs(part)


def words(type_: types.Type, *, null: str = "null", links: dict[type, str] | None = None) -> str:
    """Return a type as text: `number > 0`, `list of text`.

    Args:
        type_: Type from msgspec.
        null: Text for None.
        links: Addresses of structs with a table of their own.
    """
    match type_:
        case types.UnionType(types=parts):
            return " or ".join(words(part, null=null, links=links) for part in parts)
        case types.NoneType():
            return null
        case types.BoolType():
            return "true or false"
        case types.IntType() | types.FloatType():
            return _number(type_)
        case types.StrType(max_length=longest, pattern=pattern):
            if pattern:
                return f"text like `{pattern.removesuffix('(?!' + chr(92) + 'n)')}`"
            return f"text, at most {longest} characters" if longest else "text"
        case types.EnumType(cls=cls):
            return " or ".join(f"`{member.value}`" for member in cls)
        case types.LiteralType(values=values):
            return " or ".join(f"`{value}`" for value in values)
        case types.StructType(cls=cls):
            address = (links or {}).get(cls)
            return f"[{cls.__name__}]({address})" if address else cls.__name__
        case types.TupleType(item_types=parts):
            same = {words(part, null=null, links=links) for part in parts}
            inner = same.pop() if len(same) == 1 else ", ".join(words(p, null=null) for p in parts)
            return f"{len(parts)} of: {inner}"
        case types.VarTupleType(item_type=part) | types.ListType(item_type=part):
            return f"list of: {words(part, null=null, links=links)}"
        case types.DictType(key_type=key, value_type=value):
            return f"{words(key)} → {words(value, null=null, links=links)}"
    return type(type_).__name__.removesuffix("Type").lower()


def _parts(type_: types.Type) -> tuple[types.Type, ...]:
    match type_:
        case types.UnionType(types=parts) | types.TupleType(item_types=parts):
            return tuple(parts)
        case types.VarTupleType(item_type=part) | types.ListType(item_type=part):
            return (part,)
        case types.DictType(key_type=key, value_type=value):
            return (key, value)
    return ()


def _number(type_: types.IntType | types.FloatType) -> str:
    kind = "whole number" if isinstance(type_, types.IntType) else "number"
    bounds = (("≥", type_.ge), (">", type_.gt), ("≤", type_.le), ("<", type_.lt))
    texts = [
        f"{sign} {value:g}" for sign, value in bounds if value is not None and abs(value) < 1e12
    ]
    return " ".join((kind, ", ".join(texts))).strip()


def _default(field: types.Field) -> str:
    if field.default is not msgspec.NODEFAULT:
        return _shown(field.default)
    return _shown(field.default_factory()) if callable(field.default_factory) else ""


def _shown(value: Any) -> str:
    if isinstance(value, msgspec.Struct):
        return ""
    plain = msgspec.to_builtins(value)
    return "none" if plain is None else msgspec.json.encode(plain).decode()


def cell(text: str) -> str:
    """Escape a text for a cell of a Markdown table."""
    return text.replace("|", "\\|").replace("\n", " ")
