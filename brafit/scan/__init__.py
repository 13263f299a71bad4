"""Scans: finding, reading, checking and cleaning clouds, and turning them into the cup frame."""

from brafit.scan.body import proposed_landmarks
from brafit.scan.clean import Cleaning, clean
from brafit.scan.coverage import point_weights, uncovered_share
from brafit.scan.find import find_scans, passed_over, scan_names
from brafit.scan.frame import CupFrame
from brafit.scan.landmarks import Landmarks, landmarks_path, landmarks_text, read_breasts, read_landmarks
from brafit.scan.load import Origin, Scan, load_scan, load_sides
from brafit.scan.read import FORMATS, Cloud, read_cloud

__all__ = [
    "FORMATS",
    "Cleaning",
    "Cloud",
    "CupFrame",
    "Landmarks",
    "Origin",
    "Scan",
    "clean",
    "find_scans",
    "landmarks_path",
    "landmarks_text",
    "load_scan",
    "load_sides",
    "passed_over",
    "point_weights",
    "proposed_landmarks",
    "read_breasts",
    "read_cloud",
    "read_landmarks",
    "scan_names",
    "uncovered_share",
]
