"""Names of all fields of a message, for the tests of the information contract."""

from typing import get_args, get_type_hints

import msgspec


def fields_within(kind: object, seen: set[object] | None = None) -> set[str]:
    """Return the names of all fields of a message and of the structs in it."""
    seen = set() if seen is None else seen
    if kind in seen:
        return set()
    seen.add(kind)
    names: set[str] = set()
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        for name, hint in get_type_hints(kind, include_extras=False).items():
            if name in kind.__struct_fields__:
                names |= {name} | fields_within(hint, seen)
    for part in get_args(kind):
        names |= fields_within(part, seen)
    return names
