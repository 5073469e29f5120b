"""Interactive cards of the page: run, teleoperation, links, and playback of a recording."""
