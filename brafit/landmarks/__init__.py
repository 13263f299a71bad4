"""What a person marked on a scan: wire, neckline and points, their unit, and the cup frame that they give."""

from brafit.landmarks.cup_frame import CupFrame
from brafit.landmarks.file import Landmarks, landmarks_path, landmarks_text, read_breasts, read_landmarks

__all__ = ["CupFrame", "Landmarks", "landmarks_path", "landmarks_text", "read_breasts", "read_landmarks"]
