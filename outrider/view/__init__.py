"""Views of a flight: pictures, films, terminal and page."""
