"""Hits on their way back: collected from the device, refined in float64, located.

A batch of rays goes through `closest.py` where each ray has one answer: it is cut into pieces, a piece is cast, and its
results are refined into the arrays of the caller.

All hits take two steps. `crossings.py` casts with one kernel, which keeps the nearest few hits of each ray; rays that
may have more are cast again with four times the room, until none has. What comes back is compacted, so memory is
bounded by the hits that exist. `all_hits.py` then knows how many there are, and refines them into their final order,
ray by ray or depth by depth.
"""
