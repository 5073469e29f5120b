"""The page beside a run or a recording, the entry point `outrider.companions`."""

from outrider.running.companions import Companion

COMPANION = Companion(realtime=1.0, replays=True)
