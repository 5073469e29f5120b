"""The cards of the page that can be touched: run, wheel, links, and the player of a recording."""
