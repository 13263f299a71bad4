"""Clouds: from the bytes of a file to points, whatever wrote it."""

from brafit.cloud.read import FORMATS, Cloud, read_cloud
from brafit.cloud.reader import Reader
from brafit.cloud.refusal import RefusedError

__all__ = ["FORMATS", "Cloud", "Reader", "RefusedError", "read_cloud"]
