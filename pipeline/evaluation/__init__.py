"""Evaluation: metrics, the systems that are measured, and the run folder that holds what they answered."""
