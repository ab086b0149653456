"""Tests of the command line and of pictures ask for what the core's tests ask for."""

pytest_plugins = ["shared_fixtures"]
