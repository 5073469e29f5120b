"""Report on sweeps: intervals, pictures, a page and tables."""
