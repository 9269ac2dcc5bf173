"""Radiation between surfaces, the sky and the sun, by rays: plain functions over a tracer, arrays in and out."""

from .factors import ViewFactors, view_factors
from .sky import horizon, sky_view, sun_hours, tregenza_patches

__all__ = ["ViewFactors", "horizon", "sky_view", "sun_hours", "tregenza_patches", "view_factors"]
