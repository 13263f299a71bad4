"""A breast ready to be fitted: which files a run works on, and the assembly of a scan from cloud and landmarks."""

from brafit.scan.discovery import find_scans, passed_over, scan_names
from brafit.scan.load import Origin, Preparation, Scan, load_scan, load_sides

__all__ = [
    "Origin",
    "Preparation",
    "Scan",
    "find_scans",
    "load_scan",
    "load_sides",
    "passed_over",
    "scan_names",
]
