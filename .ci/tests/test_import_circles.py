"""Imports of the screen and the core: no module stands in a circle, however the import is hidden."""

from import_graph import circles, modules

PACKAGES = ("spatialviz", "pipeline")


def test_no_imports_run_in_a_circle() -> None:
    found = {**modules("spatialviz"), **modules("pipeline")}
    assert "spatialviz.app.site" in found
    # A package's own file names what it hands on, and everything in it lies below it.
    assert circles(found, without=PACKAGES) == set()
