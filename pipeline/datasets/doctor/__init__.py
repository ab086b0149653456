"""What may be wrong with a recording's unit of depth, camera, poses, registration and up, and what mends it."""
