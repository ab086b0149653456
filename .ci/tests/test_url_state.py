"""An address says what the page looks at, and hostile ones say nothing."""

from hypothesis import given
from hypothesis import strategies as st

from pipeline.diagnosis.whatif.state import CameraView
from spatialviz.app.state import Place

NUMBER = st.integers(-9000, 9000).map(lambda n: n / 1000)
VECTOR = st.tuples(NUMBER, NUMBER, NUMBER)
TEXT = st.text(st.characters(blacklist_categories=("Cs",)), max_size=60)


@given(
    TEXT,
    TEXT,
    st.sampled_from(["explain", "evaluate", "label"]),
    VECTOR,
    VECTOR,
    VECTOR,
    st.sampled_from([None, 2, 17]),
    st.sampled_from([None, "top", "sensor", "orbit"]),
)
def test_what_is_written_is_read(frame, text, task, position, look_at, up, pair, look) -> None:
    view = CameraView(position, look_at, up)
    place = Place("demo", frame, text, task, "SRM", None, (3, 4), (view, 0.75), pair, look)
    assert Place.read(place.query(), ["demo"]) == place


@given(TEXT)
def test_any_address_can_be_read(query: str) -> None:
    Place.read(query, ["demo"])


def test_a_dataset_that_is_not_open_says_its_name_alone() -> None:
    assert Place.read("data=/etc&frame=1&ask=mug", ["demo"]) == Place(missing="/etc")
    assert Place(missing="/etc").query() == ""
    query = "data=demo&camera=1,2,nan,4,5,6,7,8,9&item=-1,2&mode=root&stage=x&pair=-1&look=root"
    assert Place.read(query, ["demo"]) == Place("demo")
