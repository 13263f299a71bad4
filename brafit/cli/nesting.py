"""What the commands that lay patterns on one another, `brafit-nest` and `brafit-sizes`, are told alike."""

from __future__ import annotations

import argparse


def nesting_arguments() -> argparse.ArgumentParser:
    """A parent of their parsers: the folders of results, what lies on one point, whether both breasts are drawn."""
    from brafit.pattern.options import UNITS
    from brafit.sizing.nest import ALIGNS

    parser = argparse.ArgumentParser(add_help=False)
    parser.add_argument("results", nargs="+", metavar="RESULTS", help="folders of runs, or of scans in them")
    aligned = "what lies on one point in the nest (apex: the bust point); none: pieces lie side by side"
    parser.add_argument("--align", choices=ALIGNS, default="apex", help=aligned)
    parser.add_argument("--pair", action="store_true", help="draw the mirrored pieces, for the right breast, as well")
    parser.add_argument("--units", choices=tuple(UNITS), help="of texts, dimensions and DXF; not given: the fits' own")
    return parser
