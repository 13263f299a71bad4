"""Clouds: from the bytes of a file to points, whatever wrote it."""

from brafit.cloud.read import FORMATS, Cloud, read_cloud

__all__ = ["FORMATS", "Cloud", "read_cloud"]
