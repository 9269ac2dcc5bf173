"""The report's subtree pool: worker processes and the memory they share; no geometry."""
