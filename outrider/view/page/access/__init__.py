"""Access to the page: the socket, tokens and tickets, headers, and the visitors who were let in."""
