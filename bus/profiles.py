"""Named radio links, to start from: settings that a scenario, a command or an operator's page may name.

They are values of a message, so a vehicle's process, which may load no link, can list them in its help texts. The
numbers are rounded from what is commonly published for each kind of link, one way, for small messages; none is a fit
to one measurement; docs/explanation/networks.md tells the source of each, or that there is none, and holds them against
an independent simulator. Delays shorter than a tick arrive at the next tick, so at dt = 0.05 s a good Wi-Fi is a link
of one tick.
"""

from bus.messages.links import LinkSettings

PROFILES: dict[str, LinkSettings] = {
    # Nothing happens to anything.
    "perfect": LinkSettings(),
    # A good 802.11 link in line of sight: a few ms, retransmissions make a tail, short fades; the rest loses one
    # in some hundred.
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
    # The same at the edge of its range or in a busy channel: a heavy tail up to half a second, a few percent lost,
    # fades of 0.3 s every few seconds, lost acknowledgements that make duplicates.
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
    # A public 4G network: round trips of 50 to 80 ms, so 25 ms and more one way; the radio layer repeats until
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
    # A geostationary satellite: 240 to 270 ms up and down at the speed of light, the rest is processing; seldom fades.
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
    # LoRa-like: 13 bytes at spreading factor 9 and 125 kHz are 165 ms on the air (Semtech AN1200.13), 300 ms with
    # the protocol around it. Two messages a second is generous: a duty cycle of 1 % by law would allow one in 16 s.
    "narrowband": LinkSettings(
        delay=0.3,
        jitter=0.05,
        loss=0.02,
        bandwidth=2.0,
        queue=2,
        keep="newest",
    ),
    # Somebody disturbs it, half a second in two and a half, and now and then for whole seconds. Invented, not measured.
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
"""Settings by name."""
