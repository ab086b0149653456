"""Depth from colour alone: networks declared in TOML files, and datasets whose depth they estimate."""
