"""A sweep's results for people: intervals, pictures, one page, a table."""
