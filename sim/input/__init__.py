"""From a text to typed values, or to one line that says what is wrong."""
