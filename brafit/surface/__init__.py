"""A cloud as a sample of a surface: normals, cleaning, cutting out, gaps, symmetry."""

from brafit.surface.cleaning import Cleaning, clean
from brafit.surface.coverage import point_weights

__all__ = ["Cleaning", "clean", "point_weights"]
