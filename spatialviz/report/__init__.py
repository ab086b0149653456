"""Failure page: a self-contained page of an answer, to attach to an issue: reason, picture, scene, all numbers.

`picture` says which object plays which role and draws them over the image,
`tables` holds the numbers, `page` puts all on one page.
"""

from spatialviz.report.page import Subject, failure_page, write_page

__all__ = ["Subject", "failure_page", "write_page"]
