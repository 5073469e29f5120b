"""Reads and writes all payloads by the real rclpy, and compares the hashes of its types; runs in its environment.

Arguments: a folder with index.json (a list of name, type, hash and file). Prints a JSON list: one row per payload.
"""

import importlib
import json
import sys
from pathlib import Path

from rclpy.serialization import deserialize_message, serialize_message


def inverted(raw: bytes, offset: int, kind: type) -> object:
    """Return the message with one byte inverted, or None if it is no message any longer."""
    other = bytearray(raw)
    other[offset] ^= 0xFF
    try:
        return deserialize_message(bytes(other), kind)
    except Exception:  # noqa: BLE001 - the library does not export its error
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
    # Padding bytes in rclpy contain leftover memory; inverting one of them changes no message.
    relevant = [k for k in differ if inverted(raw, k, kind) != message]
    rows.append({**one, "tried": True, "same": len(again) == len(raw) and not relevant, "hashes": real == one["hash"],
                 "bytes": len(raw), "again": len(again), "padding": len(differ) - len(relevant)})  # fmt: skip
for service in ("SetBool", "Trigger"):
    hashes = json.loads((share / "std_srvs" / "srv" / f"{service}.json").read_text())["type_hashes"]
    rows.append(
        {"service": f"std_srvs/srv/{service}", "hash": hashes[0]["hash_string"], "tried": True}
    )
print(json.dumps(rows))
