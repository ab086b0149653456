"""Evaluation: the systems that are measured, the run folder, and its tables and plots.

A figure without support is NaN and never 0: precision where nothing was said
to hold, recall, average precision and F1 where nothing holds; means go over
what is defined.
"""
