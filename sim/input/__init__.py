"""Conversion of text to typed values, with one-line errors."""
