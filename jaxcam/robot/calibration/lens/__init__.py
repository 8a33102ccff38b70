"""Lenses: K and distortion from pictures of a printed board."""
