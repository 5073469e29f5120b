"""Dashboard as a companion of a run or recording; entry point `outrider.companions`."""

from outrider.running.companions import Companion

COMPANION = Companion(realtime=1.0, replays=True)
