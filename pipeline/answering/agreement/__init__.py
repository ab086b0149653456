"""How far two detectors agree on the same frames."""
