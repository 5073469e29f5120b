"""What is drawn of a flight: pictures, films, terminal and page."""
