"""The scene of a run: what every picture shows, from the notebook's to the browser's."""
