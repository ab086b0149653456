"""Corrections made elsewhere: what somebody changed in an export becomes edits in the journal.

`coco_file` and `jsonl_file` say what a file claims, `states` gives the labels
as they were exported and as they are now and keeps the claims, `importing` tells
a correction from what was corrected here since, and saves all of it or nothing.
"""
