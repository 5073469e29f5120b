"""Import real towns as scenarios."""
