"""Hits on their way back: collected from the device, refined in float64, located.

A batch of rays goes through `closest.py` where each ray has one answer: it is cut into pieces, a piece is cast, and its
results are refined into the arrays of the caller. All hits go through `all_hits.py`.
"""
