"""The fit of link settings to a recorded link, and its command."""

import json
import math

import msgspec
import pytest

from bus.messages.links import LinkSettings
from bus.profiles import PROFILES
from outrider.running.resolve import resolve
from outrider_networks.fitting import fit_link
from outrider_networks.samples import drawn_sample
from sim.channel.description import check_link
from sim.channel.recorded import RecordedLink, pack
from tabular import words


def a_trace(text: str, name: str = "trace") -> RecordedLink:
    return pack(name, text.encode())


def written(settings: LinkSettings, interval: float) -> RecordedLink:
    """Return the messages over a drawn link as a table."""
    sample = drawn_sample(settings, interval)
    rows = [
        f"{k * interval:.4f},{'lost' if math.isnan(took) else f'{took:.5f}'}"
        for k, took in enumerate(sample.delay.tolist())
    ]
    return a_trace("sent,delay\n" + "\n".join(rows))


FEW = "outrider_networks.samples._MESSAGES", 500
"""Fewer samples, for fits that do not need the nearest profile."""


def test_fit_recovers_the_settings_and_profile_of_a_link() -> None:
    poor = PROFILES["wifi-poor"]
    fit, _ = fit_link(written(poor, 0.05))
    assert fit.nearest == "wifi-poor"
    assert fit.factor < 1.1 < fit.profiles["lte"]
    found = fit.settings
    assert found.jitter_shape == "pareto"
    for field, within in (
        ("delay", 0.1),
        ("jitter", 0.1),
        ("loss", 0.2),
        ("burst_length", 0.2),
        ("burst_interval", 0.2),
        ("burst_loss", 0.1),
    ):
        assert getattr(found, field) == pytest.approx(getattr(poor, field), rel=within), field
    assert check_link(found, "fit") == found
    assert 'jitter_shape = "pareto"' in fit.toml


def test_fit_distinguishes_blackouts_from_single_losses(monkeypatch: pytest.MonkeyPatch) -> None:
    wanted = LinkSettings(
        delay=0.1, jitter=0.02, jitter_shape="normal", max_jitter=0.1, loss=0.02,
        blackout_length=0.4, blackout_interval=20.0,
    )  # fmt: skip
    recorded = written(wanted, 0.04)
    monkeypatch.setattr(*FEW)
    found = fit_link(recorded)[0].settings
    assert found.jitter_shape == "normal"
    assert found.burst_length == 0.0
    for field, within in (
        ("delay", 0.05),
        ("jitter", 0.1),
        ("loss", 0.2),
        ("blackout_length", 0.05),
        (
            "blackout_interval",
            0.5,
        ),  # three standard deviations: there are only some forty blackouts
    ):
        assert getattr(found, field) == pytest.approx(getattr(wanted, field), rel=within), field


def test_the_fit_finds_an_outage_between_opportunities() -> None:
    times = [time for time in range(1, 30_001) if not 15_000 < time < 16_000]
    fit, _ = fit_link(a_trace("\n".join(map(str, times))))
    assert fit.settings.blackout_length == 1.0
    assert fit.settings.blackout_interval == pytest.approx(29.0)
    assert fit.factor < 1.5
    assert fit.lost > 0.0  # a full queue drops messages, as in a run


def test_profile_closer_than_the_fit_is_named(monkeypatch) -> None:
    odd = LinkSettings(delay=0.05, reorder=0.3, reorder_delay=1.0)
    monkeypatch.setattr("outrider_networks.fitting.PROFILES", {"odd": odd})
    fit, _ = fit_link(written(odd, 0.05))
    assert fit.profiles["odd"] < fit.factor
    assert any("the profile odd is closer" in note for note in fit.notes)


def test_the_fit_of_a_steady_link_is_its_delay_and_nothing_else(monkeypatch) -> None:
    monkeypatch.setattr(*FEW)
    steady = fit_link(a_trace("sent,delay\n0,0.25\n0.1,0.25\n0.2,0.25\n"))[0]
    assert steady.settings == LinkSettings(delay=0.25)


def test_the_command_fits_a_mahimahi_file_and_draws_it(here, command, monkeypatch) -> None:
    monkeypatch.setattr(*FEW)
    (here / "drive").write_text("\n".join(str(k * k) for k in range(1, 60)))
    done = command(*words("network fit drive --message-bytes 90 --out fit.png --json"))
    assert done.returncode == 0, done.stderr
    fit = json.loads(done.stdout)
    assert fit["lost"] == 0.0
    assert fit["delay"]["most"] < 0.119
    assert "Mbit/s on average; longest time without an opportunity 117 ms" in fit["notes"][-1]
    assert (here / "fit.png").read_bytes().startswith(b"\x89PNG")
    (here / "drive").write_text("sent,delay\n0,lost\n")
    done = command("network", "fit", "drive")
    assert done.returncode == 2
    assert done.stderr == (
        "outrider: drive: no message arrives; allowed: recordings with received messages\n"
    )


def test_saved_fit_flies_as_a_profile(here, command, monkeypatch) -> None:
    monkeypatch.setattr(*FEW)
    rows = [f"{k / 20},{0.1 + 0.01 * (k % 7)}" for k in range(400)]
    (here / "drive.csv").write_text("sent,delay\n" + "\n".join(rows))
    for save in ("radios.toml", "radios.toml:second"):
        done = command("network", "fit", "drive.csv", "--save", save, "--json")
        assert done.returncode == 0, done.stderr
    fitted = msgspec.convert(json.loads(done.stdout)["settings"], LinkSettings)
    for name in ("radios", "second"):
        links = resolve("escort", network=f"radios.toml:{name}")[0].links
        assert links.detections == links.team == fitted
    for save, phrase in (
        ("radios.toml:second", "the file has a profile 'second'"),
        ("radios.csv", "--save radios.csv: wrong form; allowed: FILE.toml or FILE.toml:NAME"),
        ("radios.toml:My Radio", "'My Radio' is not a profile's name"),
        ("drive.csv.toml:x", "drive.csv.toml: profile: missing"),
    ):
        (here / "drive.csv.toml").write_text("duration = 1.0")
        done = command("network", "fit", "drive.csv", "--save", save)
        assert (done.returncode, phrase in done.stderr) == (2, True), done.stderr


def test_the_group_without_a_command_prints_its_help(command) -> None:
    made = command("network")
    assert made.returncode == 2
    assert "Usage: outrider network" in made.stderr.splitlines()[0]
    assert "Commands:" in made.stderr.splitlines()
