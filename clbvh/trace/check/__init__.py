"""Slow, independent answers: every triangle against every ray in float64, and counted visits."""
