"""The experiments, in chapters; each is a table of cases, a measurement, and its presentation."""
