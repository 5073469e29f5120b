"""The numbers that a certificate is given on: what is declared, and the record that compiled code reads. SI units.

The proof is in docs/explanation/certificate.md.
"""

import math
from typing import NamedTuple


class Declared(NamedTuple):
    """The facts about one UAV, its UGV and its links before a flight, and what is asked for."""

    r_v: float
    """Visibility radius [m]."""
    v_a: float
    """Largest speed of the UAV [m/s]."""
    u_a: float
    """Its largest acceleration [m/s²]."""
    v_g: float
    """Largest speed of the UGV [m/s]."""
    dt: float
    """Length of a tick [s]."""
    eps: float
    """Largest error of a detection, as a vector's norm [m]."""
    age: float
    """Largest age of the newest arrived detection, A [s]."""
    delay: float = 0.0
    """From the tick that a command answers to the one in which it acts, tau_c [s]; rounded up to whole ticks."""
    margin: float = 0.0
    """Taken off r_v [m], for what the theorem does not cover (jitter and loss of commands)."""
    width: float = math.inf
    """Of an area with walls, from 0 [m]; infinite: there are none on this axis. Plans stay in it, and what is
    detected is clipped to it."""
    height: float = math.inf
    """Likewise."""
    outage: float = 0.0
    """Longest time from the start of a motion to the start of the next, B [s]; a tick at least."""
    tracking: float = 0.0
    """A bound on the UAV's distance from where it is told that it is, w [m]; infinite: there is none."""


class Promise(NamedTuple):
    """The constants of one certificate, and what follows from them; from `agents.control.handover.certificate`."""

    dt: float
    """Length of a tick [s]."""
    error: float
    """Largest error of a detection, as a vector's norm [m]."""
    eps: float
    """Largest error of where a detection puts the UGV [m]: that, and w, as it is seen from where the UAV is told that
    it is.
    """
    tracking: float
    """A bound on the UAV's distance from where it is told that it is, w [m]."""
    age: float
    """Largest age of the newest arrived detection as it was declared, A [s]."""
    age_ticks: int
    """Likewise in whole ticks."""
    delay_ticks: int
    """From the tick that a command answers to the one in which it acts, tau_c."""
    r_v: float
    """Visibility radius [m], less the margin that was asked for, w, the sagitta of a tick and `MARGIN`."""
    v_a: float
    """Largest speed of the UAV [m/s]."""
    u_a: float
    """Largest acceleration of the UAV [m/s²]."""
    v_g: float
    """Largest speed of the UGV [m/s]."""
    width: float
    """Of the area with its walls, from 0 [m]; infinite: there are none on this axis."""
    height: float
    """Likewise."""
    handover: float
    """R_h: a plan may end where the UGV is surely within this [m]; NaN if there is none."""
    reach: float
    """E: and where the newest detection's own bound is at most this [m]; NaN if there is none."""
    interval_ticks: int
    """Longest time from the start of a motion to the start of the next, B; 1 where no command is lost."""
