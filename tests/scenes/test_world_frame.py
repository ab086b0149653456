"""A scene is asked from a frame that does not see all of it, and from where no camera stood."""

from dataclasses import replace

import numpy as np
import pytest

from pipeline.answering.answer_words import holds, reading_notes
from pipeline.answering.objects import all_objects
from pipeline.answering.pipeline import Pipeline, open_pipeline
from pipeline.scenes.object_map import ObjectMap, map_scene
from pipeline.scenes.views import posed_frames
from pipeline.scenes.world_frame import ask_world, asked_from, from_frame, imagined, presence_from
from pipeline.system import InputError

FRAME = "000001/000000"


@pytest.fixture(scope="module")
def pipeline() -> Pipeline:
    return open_pipeline("demo")


@pytest.fixture(scope="module")
def made(pipeline: Pipeline) -> ObjectMap:
    return map_scene(pipeline, "000001", posed_frames(pipeline.dataset, FRAME))


def test_what_the_frame_sees_stands_where_it_sees_it(pipeline: Pipeline, made: ObjectMap) -> None:
    world, prepared = from_frame(pipeline, made, FRAME), pipeline.prepare(FRAME)
    own = {o.id: o for o in all_objects(prepared, pipeline.needed_detector())}
    seen = [(o.id, o.numbers[FRAME]) for o in made.objects if FRAME in o.numbers]
    assert len(seen) == len(own)
    for number, of_frame in seen:
        center = world.points[number].mean(axis=0)
        lifted = own[of_frame].lifted
        low, high = lifted.points.min(axis=0) - 0.1, lifted.points.max(axis=0) + 0.1
        # Other views add what this one does not see, but no other place.
        assert ((center > low) & (center < high)).any(), (own[of_frame], center)


def test_what_the_frame_does_not_see_is_answered(pipeline: Pipeline, made: ObjectMap) -> None:
    text = "pillow on the armchair"
    assert pipeline.ask(pipeline.prepare(FRAME), text).missing
    world = from_frame(pipeline, made, FRAME)
    trace = ask_world(pipeline, world, text)
    assert holds(trace)
    assert trace.ranking is not None
    target = trace.objects[trace.ranking.pairs[0].target]
    assert target.label == "pillow"
    assert presence_from(world, target.id) == "out"
    assert not target.mask.any()


def test_an_imagined_viewpoint_faces_what_it_is_told_to(pipeline: Pipeline, made: ObjectMap) -> None:
    world = imagined(pipeline, made, "bookshelf", "armchair")
    faced = next(o for o in made.objects if o.label == "armchair")
    own = world.viewer.matrix @ (np.linalg.inv(world.pose) @ [*faced.center, 1])[:3]
    assert abs(own[0]) < 1e-6, "straight ahead"
    assert own[2] > 0
    # Whoever stands there and turns round has on the left what was on the right.
    back = imagined(pipeline, made, "armchair", "bookshelf")
    right, other_right = world.pose[:3, 0], back.pose[:3, 0]
    np.testing.assert_allclose(right, -other_right, atol=1e-9)
    assert (world.frame.depth > 0).mean() > 0.2, "the scene is in view"


def test_a_sentence_names_its_viewpoint(pipeline: Pipeline, made: ObjectMap) -> None:
    asked = "lamp left of the laptop"
    given = ask_world(pipeline, imagined(pipeline, made, "armchair", "laptop"), asked)
    # Who faces nothing in particular faces the reference.
    for text in (f"from the armchair, facing the laptop: {asked}", f"{asked}, as seen from the armchair"):
        rest, world = asked_from(pipeline, made, text)
        assert world is not None
        assert world.frame.id == "at armchair facing laptop"
        trace = ask_world(pipeline, world, rest)
        assert trace.ranking is not None
        assert given.ranking is not None
        assert trace.ranking.pairs[0] == given.ranking.pairs[0]
    rest, world = asked_from(pipeline, made, "standing at the armchair facing the laptop, left of the laptop")
    assert rest == "what is left of the laptop"
    assert world is not None
    assert asked_from(pipeline, made, asked) == (asked, None)
    with pytest.raises(InputError, match="no such object"):
        asked_from(pipeline, made, f"{asked}, as seen from the unicorn")


@pytest.mark.parametrize(
    ("at", "facing", "words"),
    [
        ("unicorn", "laptop", "no such object"),
        ("book", "laptop", "objects called book"),
        ("laptop", "laptop", "what they stand at"),
        ("laptop", "laptop 3", "no such object|is no laptop"),
    ],
)
def test_a_viewpoint_that_cannot_be_is_refused(
    pipeline: Pipeline, made: ObjectMap, at: str, facing: str, words: str
) -> None:
    with pytest.raises(InputError, match=words):
        imagined(pipeline, made, at, facing)


def test_a_frame_that_is_not_of_the_map_is_refused(pipeline: Pipeline, made: ObjectMap) -> None:
    with pytest.raises(InputError, match="no place in the map"):
        from_frame(pipeline, made, "000002/000000")


def test_who_stands_at_a_thing_sees_past_it_what_they_face(pipeline: Pipeline, made: ObjectMap) -> None:
    """The bookshelf is taller than a person, the laptop lies below the eyes of who stands at its desk."""
    laptop = next(o.id for o in made.objects if o.label == "laptop")
    for at in ("bookshelf", "desk", "rug"):
        world = imagined(pipeline, made, at, "laptop")
        assert presence_from(world, laptop) == "seen", at
        assert world.frame.depth.max() < 20
        assert not world.notes


def test_a_thing_is_named_by_its_id_or_by_another_word_and_that_is_told(pipeline: Pipeline, made: ObjectMap) -> None:
    books = [o.id for o in made.objects if o.label == "book"]
    with pytest.raises(InputError, match=f"book {books[0]} | book {books[1]}"):
        imagined(pipeline, made, "book", "laptop")
    for name in (f"book {books[1]}", f"book·{books[1]}", str(books[1])):
        assert imagined(pipeline, made, name, "armchair").frame.id == "at book facing armchair"
    assert imagined(pipeline, made, "sofa", "laptop").notes == (
        f"'sofa' taken as armchair {next(o.id for o in made.objects if o.label == 'armchair')}",
    )


def test_a_frame_that_was_left_out_says_so(pipeline: Pipeline, made: ObjectMap) -> None:
    doubted = replace(made, left_out={FRAME: "its pose does not fit"})
    (note,) = from_frame(pipeline, doubted, FRAME).notes
    assert "left out of the map: its pose does not fit" in note
    trace = ask_world(pipeline, from_frame(pipeline, made, FRAME), "the tallest lamp")
    assert trace.detector == "object map"
    assert "goes by whole boxes" in " ".join(reading_notes(trace))
