"""Failure page: a self-contained page of an answer, to attach to an issue: reason, picture, scene, all stages.

`picture` says which object plays which role and draws them over the image, `page` puts all on one page.
"""
