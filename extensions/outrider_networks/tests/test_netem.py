"""Links as commands for tc-netem."""

import json
import re
import shutil
import subprocess

import pytest

from bus.messages.links import LinkKind, LinkSettings
from bus.profiles import SHIPPED
from outrider_networks.netem import netem_line, netem_lines
from sim.channel.description import link_parameters
from sim.channel.gaps import loss_chain
from sim.scenario.loading import load_scenario


def options(settings, rate=20.0):
    """Return the options after `netem`."""
    return netem_line("mine", settings, rate, "eth0").command.partition(" netem")[2].strip()


@pytest.mark.parametrize(
    ("settings", "expected"),
    [
        (LinkSettings(), ""),
        (LinkSettings(delay=0.02, loss=0.015), "delay 20ms loss random 1.5%"),
        (LinkSettings(delay=0.02, jitter=0.005), "delay 20ms 5ms"),
        (LinkSettings(delay=0.002, jitter=0.005), "delay 3.5ms 3.5ms"),  # from -delay to jitter
        (LinkSettings(delay=0.02, jitter=0.005, jitter_time=0.05), "delay 20ms 5ms 36.7879%"),
        (LinkSettings(duplicates=0.01), "duplicate 1%"),
        (
            LinkSettings(delay=0.5, bandwidth=4.0, queue=3, message_bytes=100),
            "delay 500ms rate 3200bit limit 5",
        ),
    ],
)
def test_links_that_netem_has_are_its_options(settings, expected) -> None:
    assert options(settings) == expected


@pytest.mark.parametrize("shape", ["exponential", "pareto"])
def test_one_sided_jitter_keeps_the_smallest_and_the_mean_delay(shape) -> None:
    settings = LinkSettings(delay=0.05, jitter=0.01, jitter_shape=shape, max_jitter=10.0)
    mean, scale = map(float, re.findall(r"([\d.]+)ms", options(settings)))
    assert mean - scale * 2.0 / 3.0 == pytest.approx(50.0, abs=1e-3)
    assert mean == pytest.approx(60.0, rel=0.01)
    assert "distribution pareto" in options(settings)


@pytest.mark.parametrize("rate", [5.0, 20.0])
@pytest.mark.parametrize("name", ["wifi", "wifi-poor", "jammed"])
def test_loss_model_has_the_share_and_length_of_the_bursts(name, rate) -> None:
    settings = SHIPPED[name]
    text = re.search(r"gemodel ([\d.]+)% ([\d.]+)% ([\d.]+)% ([\d.]+)%", options(settings, rate))
    enter, leave, in_bad, in_good = (float(one) / 100.0 for one in text.groups())
    bad = enter / (enter + leave)
    chain = loss_chain(link_parameters(settings, 1.0 / rate))
    assert bad == pytest.approx(chain.share[1], rel=1e-4)
    lost = bad * in_bad + (1.0 - bad) * in_good
    assert lost == pytest.approx(1.0 - chain.share @ chain.through, rel=1e-4)
    assert 1.0 - leave == pytest.approx(chain.turn[1, 1], rel=1e-4)


def test_all_that_netem_lacks_is_named() -> None:
    settings = LinkSettings(
        delay=0.01, jitter=0.02, jitter_shape="normal", jitter_time=1.0, burst_length=1.0, burst_interval=5.0,
        reorder=0.1, reorder_delay=0.1, blackouts=((3.0, 1.0),), blackout_interval=9.0, blackout_length=1.0,
        bandwidth=5.0,
    )  # fmt: skip
    found = " | ".join(netem_line("mine", settings, 20.0, "eth0").differences)
    for word in (
        "jitter_shape", "jitter_time", "bursts", "reorder", "blackouts: 1 planned", "blackout_interval", "bandwidth",
        "queue", "keep",
    ):  # fmt: skip
        assert word in found
    line = netem_line("mine", LinkSettings(trace="drive.csv"), 20.0, "eth0")
    assert line.command is None
    assert "fit it first" in line.differences[0]


def test_each_link_of_a_scenario_has_its_settings_and_rate() -> None:
    changes = ["detections.rate=5", "links.commands.delay=0.1"]
    lines = netem_lines(load_scenario("escort", overrides=changes), "wlan0")
    by_link = {line.link: line for line in lines}
    assert {name.partition("/")[2] for name in by_link} == set(LinkKind) - {LinkKind.TEAM}
    assert by_link["uav_0/detections"].rate == 5.0
    command = by_link["ugv_0/commands"]
    assert command.command == "tc qdisc add dev wlan0 root netem delay 100ms"
    assert command.rate == 20.0


LATE = LinkSettings(delay=0.1, jitter=0.1, jitter_shape="exponential", jitter_time=0.3)


@pytest.mark.parametrize("name", [*SHIPPED, "late"])
def test_tc_accepts_the_commands(name) -> None:
    if shutil.which("tc") is None:
        pytest.skip("iproute2 is not installed")
    command = netem_line(name, SHIPPED.get(name, LATE), 20.0, "outrider-none").command
    done = subprocess.run(command.split(), capture_output=True, text=True, check=False)
    # options are parsed before the device is searched for
    assert "Cannot find device" in done.stderr, done.stderr


def test_command_takes_a_scenario_or_a_profile(here, command) -> None:
    (here / "radios.toml").write_text("[profile.near]\ndelay = 0.01\n[profile.far]\nloss = 0.1\n")
    done = command("network", "netem", "radios.toml:far", "--device", "wlan0")
    assert done.stdout == (
        "# radios.toml:far: 20 messages per second\ntc qdisc add dev wlan0 root netem loss random 10%\n"
    )
    done = command("network", "netem", "escort", "--network", "radios.toml:near", "--json")
    assert {line["link"] for line in json.loads(done.stdout)} >= {"uav_0/detections"}
    for words, phrase in (
        (("radios.toml",), "a file of several profiles; allowed: radios.toml:near"),
        (("wifi", "--network", "lte"), "--network: wifi is a profile"),
        (("escort", "--rate", "5"), "--rate 5: the scenario defines the rates"),
        (("wifi", "--device", "a b"), "--device a b: not a network device"),
        (("wifo",), "no such file or scenario"),
    ):
        done = command("network", "netem", *words)
        assert (done.returncode, phrase in done.stderr) == (2, True), done.stderr
