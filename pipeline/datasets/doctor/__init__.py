"""Diagnosis of a recording's depth unit, camera, poses, registration and up, with fixes."""
