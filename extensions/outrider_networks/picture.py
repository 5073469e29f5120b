"""Plot of a fit: delays, bursts of loss and waits of the recorded link, the fit and the nearest profile."""

from pathlib import Path

import numpy as np
from matplotlib.axes import Axes
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from outrider import style
from outrider_networks.fitting import Fit
from outrider_networks.samples import Sample
from sim.compiling.compile import FloatArray

_STYLES = {
    "recorded": (style.INK, "-", 2.6),
    "fitted": (style.UAV[0], "-", 1.6),
    "nearest": (style.UGV[0], style.DASHED, 1.6),
}
"""Colour, line style and line width."""
_LEAST = 1e-4
"""Lower limit of plotted times [s]."""
_WIDE = 300.0
"""Axis ratio above which only powers of ten are labelled."""


def draw_fit(fit: Fit, samples: dict[str, Sample], path: Path) -> None:
    """Draw the distributions of the recorded link, the fitted one and the nearest profile.

    Args:
        fit: Result of the fit.
        samples: Samples `recorded`, `fitted` and, if there is one, `nearest`.
        path: PNG file.

    Raises:
        OSError: If the file cannot be written.
    """
    names = {
        "recorded": "recorded",
        "fitted": "fitted settings",
        "nearest": f"nearest profile: {fit.nearest}",  # if there is one
    }
    with style.plot_style():
        figure = style.new_figure(1680, 620, header=0.14)
        delays, bursts, waits = figure.subplots(1, 3)
        for name, sample in samples.items():
            color, line, width = _STYLES[name]
            line_style = {
                "color": color,
                "linestyle": line,
                "linewidth": width,
                "label": names[name],
            }
            _shares(delays, sample.arrived, line_style)
            _bursts(bursts, sample, line_style)
            _beyond(waits, np.sort(sample.waits), line_style)
        _times(delays, "delay of a message that arrives")
        delays.set_ylabel("share of messages with at most this delay")
        delays.yaxis.set_major_formatter(_PERCENT)
        delays.set_ylim(0.0, 1.02)
        _times(bursts, "duration of a burst of loss")
        bursts.set_ylabel("bursts of at least this duration [1/h]")
        if not any(sample.bursts.size for sample in samples.values()):
            bursts.text(0.5, 0.5, "no losses", ha="center", transform=bursts.transAxes)
        _times(waits, "wait until a message or a later one arrives")
        waits.set_ylabel("share of messages with a longer wait")
        for axes, letter, title in (
            (delays, "a", "Delay"),
            (bursts, "b", "Bursts of loss"),
            (waits, "c", "Delay and loss combined"),
        ):
            style.panel(axes, letter, title)
        lost = ", ".join(f"{name} {100.0 * one.lost:.2g} %" for name, one in samples.items())
        sent = f"{fit.messages:,} messages, one every {fit.interval:g} s"
        style.heading(figure, f"{style.plain(fit.file)}: {sent}; lost: {lost}", 0.975, 12.0)
        handles, labels = delays.get_legend_handles_labels()
        figure.legend(handles, labels, loc="upper left", ncols=3, bbox_to_anchor=(0.004, 0.935))
        style.save(figure, path)


_PERCENT = FuncFormatter(lambda value, _: f"{100.0 * value:g} %")


def _times(axes: Axes, label: str) -> None:
    """Format the horizontal axis; call it after plotting."""
    axes.set_xscale("log")
    axes.set_xlabel(f"{label} [ms]")
    low, high = axes.get_xlim()
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if high / low < _WIDE else (1.0,)))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{1000.0 * value:g}"))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _shares(axes: Axes, values: FloatArray, line_style: dict[str, object]) -> None:
    """Plot the cumulative distribution."""
    shares = np.arange(1, len(values) + 1) / len(values)
    axes.step(np.maximum(values, _LEAST), shares, where="post", **line_style)  # type: ignore[arg-type]


def _beyond(axes: Axes, values: FloatArray, line_style: dict[str, object]) -> None:
    """Plot the complementary distribution."""
    axes.set_yscale("log")
    shares = 1.0 - np.arange(len(values)) / len(values)
    axes.step(np.maximum(values, _LEAST), shares, where="pre", **line_style)  # type: ignore[arg-type]
    axes.yaxis.set_major_formatter(_PERCENT)
    axes.yaxis.set_minor_formatter(NullFormatter())


def _bursts(axes: Axes, sample: Sample, line_style: dict[str, object]) -> None:
    """Plot the number of bursts per hour with at least each length."""
    lengths = np.sort(sample.bursts) * sample.interval
    if not lengths.size:
        return
    axes.set_yscale("log")
    axes.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:,g}"))
    axes.yaxis.set_minor_formatter(NullFormatter())
    hours = len(sample.delay) * sample.interval / 3600.0
    axes.step(lengths, np.arange(len(lengths), 0, -1) / hours, where="pre", **line_style)  # type: ignore[arg-type]
