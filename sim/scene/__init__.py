"""Scene of a run: the content of every picture, from notebooks to the browser."""
