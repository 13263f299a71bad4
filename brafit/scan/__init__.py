"""Scans: finding, reading, checking and cleaning clouds, and turning them into the cup frame."""

from brafit.scan.clean import Cleaning, clean
from brafit.scan.find import find_scans, scan_names
from brafit.scan.frame import CupFrame
from brafit.scan.landmarks import Landmarks, landmarks_path, read_landmarks
from brafit.scan.load import Scan, load_scan
from brafit.scan.read import Cloud, read_cloud

__all__ = [
    "Cleaning",
    "Cloud",
    "CupFrame",
    "Landmarks",
    "Scan",
    "clean",
    "find_scans",
    "landmarks_path",
    "load_scan",
    "read_cloud",
    "read_landmarks",
    "scan_names",
]
