"""What every test of the core can ask for."""

pytest_plugins = ["shared_fixtures"]
