"""What is found on a body that nobody marked: its axes, its breasts, their creases."""

from brafit.anatomy.torso import proposed_landmarks

__all__ = ["proposed_landmarks"]
