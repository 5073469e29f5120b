"""A recorded link beside the links that are drawn: which settings come nearest to it, and how near."""
