"""The vehicles' pilots: each decides, and knows only what it may."""
