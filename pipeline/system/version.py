"""The version of this program: what a release changes."""

__version__ = "0.1.0"
