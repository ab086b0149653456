"""Check of the public face with a screen: what importing loads, and the page on arrays."""

import json
import subprocess
import sys
import urllib.request

import numpy as np

import pipeline
import spatialviz as sp
from pipeline.datasets.demo import demo_run

HEAVY = ("torch", "open3d", "viser", "numpy", "scipy", "cv2", "pydantic", "onnxruntime", "IPython")
QUESTION = "mug left of the laptop"


def loaded_by(code: str) -> set[str]:
    """Which of the heavy libraries a fresh interpreter has loaded after the code."""
    code += f"; import json, sys; print(json.dumps([n for n in {HEAVY} if n in sys.modules]))"
    return set(json.loads(subprocess.run([sys.executable, "-c", code], capture_output=True, check=True).stdout))


def check_imports() -> None:
    assert set(sp.__all__) == {*pipeline.__all__, "show", "__version__"}
    own = {"ask", "open", "show", "__version__"}
    assert all(getattr(sp, name) is getattr(pipeline, name) for name in sp.__all__ if name not in own)
    assert set(sp.__all__) <= set(dir(sp))
    assert not loaded_by("import spatialviz, pipeline")
    asking = f"import spatialviz as sp; sp.ask('demo', 0, {QUESTION!r}); sp.show"
    assert not {"torch", "open3d", "viser", "IPython"} & loaded_by(asking)


def check_page() -> None:
    frame = sp.open("demo").frames[0]
    seen = [a for a in frame.annotations if a.mask is not None]
    masks = np.array([a.mask for a in seen])
    opened = sp.open("demo")
    for what, options in (
        (frame.rgb, {"depth": frame.depth, "K": frame.camera.K, "masks": masks, "names": [a.label for a in seen]}),
        (frame, {}),
        (opened, {}),
        (opened.ask(0, QUESTION), {}),
        (sp.open_run(demo_run()), {}),
    ):
        server = sp.show(what, **options, port=0, open_browser=False, block=False)
        assert server is not None
        with urllib.request.urlopen(f"http://127.0.0.1:{server.get_port()}", timeout=20) as page:
            assert page.status == 200
        server.stop()
    for wrong in ((frame.rgb,), (frame, frame.depth)):
        try:
            sp.show(*wrong, open_browser=False, block=False)
        except sp.InputError:
            continue
        raise SystemExit(f"shown, and should not be: {len(wrong)} arguments")


if __name__ == "__main__":
    check_imports()
    check_page()
    print("the public face answers, and is shown")
