"""The quality `high`: the default tree, rearranged by reinsertion."""
