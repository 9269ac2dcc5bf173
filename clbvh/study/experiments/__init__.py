"""The experiments, one file each: a table of cases, a measurement, and its presentation."""
