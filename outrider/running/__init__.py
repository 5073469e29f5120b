"""Starting and ending a run, in processes or in this one, and what it leaves behind."""
