"""Version of this program, changed by a release."""

__version__ = "0.2.0"
