"""Who may look at the page: the socket, tokens and tickets, headers, and the visitors who were let in."""
