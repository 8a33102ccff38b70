"""Cameras as rays: Plücker maps, camera records, conversions, and pose sampling.

Loads nothing but JAX and NumPy, so that any project can use it on its own.
"""

from jaxcam.rays._camera import Camera
from jaxcam.rays._plucker import plucker

__all__ = ["Camera", "plucker"]
