"""Work of commands whose help must not wait for a compiler or need an extra."""
