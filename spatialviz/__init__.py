"""The face of spatialviz: the command line and the browser page. All computing is in `pipeline`."""

from pipeline import __version__

__all__ = ["__version__"]
