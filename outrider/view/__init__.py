"""Views of a flight: pictures, films and the terminal."""
