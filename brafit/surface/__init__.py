"""A cloud as a sample of a surface: normals, cleaning, thinning, cutting out, gaps, symmetry."""

from brafit.surface.cleaning import Cleaning
from brafit.surface.coverage import point_weights

__all__ = ["Cleaning", "point_weights"]
