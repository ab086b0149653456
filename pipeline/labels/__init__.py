"""Auto-labels: from frames to checked expressions; their schema, their making, their checks and their exports."""
