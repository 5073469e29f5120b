"""Saving of fitted link settings as a profile of the user's own."""

import re
from pathlib import Path

import msgspec

from bus.errors import ScenarioError
from bus.files import read_regular, write_whole
from bus.messages.links import LinkSettings
from bus.profiles import NAME_RULE, is_profile_name
from sim.input.faults import one_line
from sim.scenario.link_profiles import FILE_FORM, read_profiles, split_name

_MOST_BYTES = 1 << 20


def check_target(target: str) -> tuple[Path, str]:
    """Return the file and the name of a profile to save, `FILE.toml` or `FILE.toml:NAME`.

    Without a name, it is the file's, with `-` for all that a name must not contain.

    Raises:
        ScenarioError: If it has another form.
    """
    path, name = split_name(target)
    if not path:
        raise ScenarioError(f"--save {one_line(target)}: wrong form; allowed: {FILE_FORM}")
    file = Path(path)
    name = name or re.sub(r"[^a-z0-9_-]+", "-", file.stem.lower()).strip("-")
    if not is_profile_name(name):
        wrong = f"{one_line(name)!r} is not a profile's name"
        raise ScenarioError(f"--save {one_line(target)}: {wrong}; allowed: {NAME_RULE}")
    return file, name


def save_profile(target: str, settings: LinkSettings, about: str) -> str:
    """Write a profile to a new file, or append it to a file of profiles.

    Args:
        target: `FILE.toml` or `FILE.toml:NAME`.
        settings: Settings of the profile.
        about: Comment, one line.

    Returns:
        The profile's name for `--network`.

    Raises:
        ScenarioError: If the file is not one of profiles, or has this profile.
        OSError: If it cannot be written.
    """
    file, name = check_target(target)
    try:
        before = read_regular(file, _MOST_BYTES)
        known = read_profiles(before, str(file))
    except FileNotFoundError:
        before, known = b"", {}
    if name in known:
        wrong = f"the file has a profile {name!r}"
        raise ScenarioError(f"--save {one_line(target)}: {wrong}; allowed: another name or file")
    gap = b"" if not before else b"\n" if before.endswith(b"\n") else b"\n\n"
    text = f"# {one_line(about)}\n[profile.{name}]\n{settings_toml(settings)}\n"
    write_whole(file, before + gap + text.encode())
    return f"{file}:{name}"


def settings_toml(settings: LinkSettings) -> str:
    """Return the fields that differ from a perfect link, in the scenario's format."""
    return "\n".join(
        f"{field} = {msgspec.json.encode(value).decode()}"
        for field, value in settings.changes().items()
    )
