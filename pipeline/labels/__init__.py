"""Labels: what the geometry of annotated frames says, in words and tables."""
