"""brafit: brassiere cups of developable panels, from a scan to flat patterns."""

__version__ = "0.1.0"
