"""Several threads, forked children, Ctrl-C, and what is left behind."""
