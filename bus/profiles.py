"""Named radio links: presets for scenarios, commands and the operator's page.

They are values of a message, so that a vehicle's process, which must not import links, can list them in its help texts.
The numbers are rounded from commonly published values for each kind of link, one way, for small messages; none is
fitted to one measurement. docs/how-to/network.md gives the sources and compares the profiles with an independent
simulator. Delays shorter than a tick arrive at the next tick: at dt = 0.05 s a good Wi-Fi is a link of one tick.
"""

from bus.messages.links import LinkSettings

PROFILES: dict[str, LinkSettings] = {
    # No delay, no loss.
    "perfect": LinkSettings(),
    # A good 802.11 link in line of sight: a few ms, a tail from retransmissions, short fades; the remaining loss is a
    # few per thousand.
    "wifi": LinkSettings(
        delay=0.003,
        jitter=0.003,
        jitter_shape="exponential",
        max_jitter=0.1,
        loss=0.002,
        burst_length=0.05,
        burst_interval=10.0,
        burst_loss=0.5,
        duplicates=0.0005,
    ),
    # Wi-Fi at the edge of its range or in a busy channel: a heavy tail up to half a second, a few percent lost, fades
    # of 0.3 s every few seconds, duplicates from lost acknowledgements.
    "wifi-poor": LinkSettings(
        delay=0.01,
        jitter=0.03,
        jitter_shape="pareto",
        max_jitter=0.5,
        loss=0.03,
        burst_length=0.3,
        burst_interval=4.0,
        burst_loss=0.9,
        duplicates=0.005,
        reorder=0.005,
        reorder_delay=0.05,
    ),
    # A public 4G network: round trips of 50 to 80 ms, so 25 ms and more one way; the radio layer retransmits until
    # little is lost; a handover interrupts for some tens of ms, here once a minute.
    "lte": LinkSettings(
        delay=0.025,
        jitter=0.01,
        jitter_shape="exponential",
        max_jitter=0.3,
        loss=0.001,
        blackout_interval=60.0,
        blackout_length=0.1,
    ),
    # A geostationary satellite: 240 to 270 ms up and down at the speed of light, the rest is processing; rare fades.
    "satellite": LinkSettings(
        delay=0.28,
        jitter=0.01,
        jitter_shape="normal",
        max_jitter=0.05,
        loss=0.003,
        burst_length=1.0,
        burst_interval=120.0,
        burst_loss=0.5,
    ),
    # LoRa-like: 13 bytes at spreading factor 9 and 125 kHz take 165 ms on the air (Semtech AN1200.13), 300 ms with
    # protocol overhead. Two messages a second is generous: a legal duty cycle of 1 % would allow one in 16 s.
    "narrowband": LinkSettings(
        delay=0.3,
        jitter=0.05,
        loss=0.02,
        bandwidth=2.0,
        queue=2,
        keep="newest",
    ),
    # A jammer that disturbs half a second in two and a half, and sometimes whole seconds. Invented, not measured.
    "jammed": LinkSettings(
        delay=0.02,
        jitter=0.02,
        jitter_shape="exponential",
        loss=0.05,
        burst_length=0.5,
        burst_interval=2.0,
        burst_loss=0.95,
        blackout_interval=20.0,
        blackout_length=2.0,
    ),
}
"""Link settings by name of the profile."""
