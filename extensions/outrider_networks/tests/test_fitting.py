"""The fit of link settings to a recorded link, and its command."""

import json
import math

import msgspec
import numpy as np
import pytest
from scipy.special import ndtri

from bus.errors import ScenarioError
from bus.messages.links import LinkSettings
from bus.profiles import PROFILES
from outrider.running.resolve import resolve
from outrider_networks.correlation_fit import autocorrelation
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


@pytest.mark.parametrize("shape", ["exponential", "normal"])
def test_fit_recovers_the_correlation_time_of_delays(shape) -> None:
    wanted = LinkSettings(
        delay=0.2, jitter=0.03, jitter_shape=shape, max_jitter=0.15, jitter_time=0.4, loss=0.05
    )
    fit, samples = fit_link(written(wanted, 0.05))
    assert fit.settings.jitter_time == pytest.approx(0.4, rel=0.15)
    assert fit.factor < 1.1
    assert autocorrelation(samples["fitted"], 4) == pytest.approx(math.exp(-0.5), abs=0.07)
    apart = msgspec.structs.replace(wanted, jitter_time=0.0)
    assert fit_link(written(apart, 0.05))[0].settings.jitter_time == 0.0


def test_the_fit_finds_an_outage_between_opportunities() -> None:
    times = [time for time in range(1, 30_001) if not 15_000 < time < 16_000]
    fit, _ = fit_link(a_trace("\n".join(map(str, times))))
    assert fit.settings.blackout_length == 1.0
    assert fit.settings.blackout_interval == pytest.approx(29.0)
    assert fit.factor < 1.5
    assert fit.lost > 0.0  # a full queue drops messages, as in a run


def test_profile_closer_than_the_fit_is_named(monkeypatch) -> None:
    odd = LinkSettings(delay=0.05, reorder=0.3, reorder_delay=1.0)
    monkeypatch.setattr("outrider_networks.nearest.PROFILES", {"odd": odd})
    fit, _ = fit_link(written(odd, 0.05))
    assert fit.profiles["odd"] < fit.factor
    assert any("the profile odd is closer" in note for note in fit.notes)


def test_the_fit_of_a_steady_link_is_its_delay_and_nothing_else(monkeypatch) -> None:
    monkeypatch.setattr(*FEW)
    rows = "".join(f"{k / 10},0.25\n" for k in range(40))
    steady = fit_link(a_trace(f"sent,delay\n{rows}"))[0]
    assert steady.settings == LinkSettings(delay=0.25)


def random_rows(count: int, loss: float = 0.0, delay: float = 0.02345678) -> str:
    """Return messages with exponential jitter, of which a share is lost."""
    rng = np.random.default_rng(5)
    delays, lost = delay + rng.exponential(0.005, count), rng.random(count) < loss
    rows = (
        f"{k / 20},{'lost' if gone else took}"
        for k, (took, gone) in enumerate(zip(delays.tolist(), lost.tolist(), strict=True))
    )
    return "sent,delay\n" + "\n".join(rows)


def test_fit_of_few_messages_is_refused_or_has_a_warning(monkeypatch) -> None:
    monkeypatch.setattr(*FEW)
    for count, phrase in ((1, "1 message arrives: too few"), (29, "29 messages arrive: too few")):
        with pytest.raises(ScenarioError, match=phrase):
            fit_link(a_trace(random_rows(count)))
    assert (
        "only 30 messages arrive: losses below 10 %"
        in fit_link(a_trace(random_rows(30)))[0].notes[0]
    )
    assert not fit_link(a_trace(random_rows(300)))[0].notes
    with pytest.raises(ScenarioError, match=r"smallest delay is 31 s; allowed: 30 s or less"):
        fit_link(a_trace(random_rows(40, delay=31.0)))


@pytest.mark.parametrize(
    "text",
    [
        random_rows(30),
        random_rows(2000),
        "sent,delay\n" + "\n".join(f"{k},{0.1234567 + 0.01 * (k * 7 % 40)}" for k in range(400)),
        "sent,delay\n" + "\n".join(f"{k},{0.30123 + 0.02 * ndtri((k * 7 % 400 + 0.5) / 400)}" for k in range(400)),
        "sent,delay\n" + "\n".join(f"{k},0.1234567" for k in range(40)),
    ],
    ids=["few", "exponential", "uniform", "normal", "steady"],
)  # fmt: skip
def test_no_fitted_delay_is_below_the_smallest_recorded_one(text, monkeypatch) -> None:
    monkeypatch.setattr(*FEW)
    fit, samples = fit_link(a_trace(text))
    least, settings = fit.delay["least"], fit.settings
    assert settings.delay >= least * (1.0 - 1e-9)
    if settings.jitter_shape == "normal":  # without a lower limit
        assert settings.jitter * 3.0 <= settings.delay - least
    elif settings.jitter_shape == "uniform":
        assert settings.delay - settings.jitter >= least * (1.0 - 1e-9)
    assert samples["fitted"].arrived[0] >= least - 0.005


@pytest.mark.parametrize(
    ("loss", "nearest"), [(0.0, "wifi"), (0.002, "wifi"), (0.5, "wifi-poor"), (0.94, "wifi-poor")]
)
def test_recommended_profile_has_a_similar_loss(loss, nearest, monkeypatch) -> None:
    monkeypatch.setattr(*FEW)
    profiles = {name: PROFILES[name] for name in ("perfect", "wifi", "wifi-poor")}
    monkeypatch.setattr("outrider_networks.nearest.PROFILES", profiles)
    fit, samples = fit_link(a_trace(random_rows(4000, loss, delay=0.002)))
    assert fit.nearest == nearest
    assert fit.losses["wifi"] == pytest.approx(0.002 + 0.5 * 0.05 / 10.05, rel=0.01)
    monkeypatch.setattr(
        "outrider_networks.nearest.PROFILES",
        {"odd": LinkSettings(delay=0.002, loss=1e-6 if loss else 0.1)},
    )
    fit, samples = fit_link(a_trace(random_rows(4000, loss, delay=0.002)))
    assert fit.nearest is None
    assert "nearest" not in samples


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
