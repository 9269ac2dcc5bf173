"""The ways in which the variants of the ladder find the two halves of a range."""

SORT = 0  # sort the whole range, cut in the middle
SELECT = 1  # find the median, cut there
BINS = 2  # count the range in bins, cut at the boundary next to the median
