"""Reads and writes every payload by the real rclpy, and tells its types' hashes: runs in its environment.

Arguments: a folder with index.json (a list of name, type, hash and file). Prints a JSON list: one row a payload.
"""

import importlib
import json
import sys
from pathlib import Path

from rclpy.serialization import deserialize_message, serialize_message


def turned(raw: bytes, place: int, kind: type) -> object:
    """The message with one byte turned over; None if it is none any longer."""
    other = bytearray(raw)
    other[place] ^= 0xFF
    try:
        return deserialize_message(bytes(other), kind)
    except Exception:  # noqa: BLE001 - the library's own error, which it does not export
        return None


folder, share = Path(sys.argv[1]), Path(sys.prefix) / "share"
rows = []
for one in json.loads((folder / "index.json").read_text()):
    package, _, name = one["type"].split("/")
    described = share / package / "msg" / f"{name}.json"
    if not described.exists():
        rows.append({**one, "tried": False})
        continue
    hashes = json.loads(described.read_text())["type_hashes"]
    real = next(each["hash_string"] for each in hashes if each["type_name"] == one["type"])
    kind = getattr(importlib.import_module(f"{package}.msg"), name)
    raw = (folder / one["file"]).read_bytes()
    message = deserialize_message(raw, kind)
    again = serialize_message(message)
    differ = [k for k, (a, b) in enumerate(zip(raw, again, strict=False)) if a != b]
    # Between two fields rclpy leaves what was in memory: such a byte means nothing, and turned over it changes nothing.
    telling = [k for k in differ if turned(raw, k, kind) != message]
    rows.append({**one, "tried": True, "same": len(again) == len(raw) and not telling, "hashes": real == one["hash"],
                 "bytes": len(raw), "again": len(again), "padding": len(differ) - len(telling)})  # fmt: skip
for service in ("SetBool", "Trigger"):
    hashes = json.loads((share / "std_srvs" / "srv" / f"{service}.json").read_text())["type_hashes"]
    rows.append(
        {"service": f"std_srvs/srv/{service}", "hash": hashes[0]["hash_string"], "tried": True}
    )
print(json.dumps(rows))
