"""Parts of the environments: settings, observations, rewards, spaces, standings, rendering."""
