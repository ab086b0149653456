"""Language features: every format, what is known and what is not, and the contract of a network."""

from __future__ import annotations

import gzip
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vector_writers import vec_text, written

from pipeline.language import LanguageContract, VectorFile, open_vectors
from pipeline.language.phrase_vectors import phrase_words
from pipeline.language.vectors import VecFile, VectorTable
from pipeline.system import InputError

RNG = np.random.default_rng(11)
WORDS = ("chair", "table", "mug", "trash", "can", "t", "shirt", "box", "of", "tissue", "Polaroid", "TV", "café")
VECTORS = {w: RNG.normal(size=5).astype(np.float32) for w in WORDS}


@pytest.fixture
def vec(tmp_path: Path) -> Path:
    return written(tmp_path / "words.vec", vec_text(VECTORS))


def word_table(path: Path, kind: str = "word") -> Path:
    np.savez(path, words=np.array(WORDS), vectors=np.stack(list(VECTORS.values())), kind=kind)
    return path


# Words of names.


@pytest.mark.parametrize(
    ("name", "expected"),
    [
        ("trash_can", ["trash", "can"]),
        ("CoffeeTables", ["coffee", "table"]),
        ("the_Coffee_Tables", ["coffee", "table"]),
        ("boxes_of_tissues", ["box", "of", "tissues"]),
        ("wine glasses", ["wine", "glass"]),
        ("sunglasses", ["sunglasses"]),
        ("bat_(animal)", ["bat"]),
        ("bookcase / shelf", ["bookcase"]),
        ("T-shirts", ["t-shirt"]),
        ("TV", ["tv"]),
        ("???", []),
        ("", []),
    ],
)
def test_words_of_a_name(name: str, expected: list[str]) -> None:
    assert [w.text for w in phrase_words(name)] == expected


@given(st.text(max_size=30))
def test_words_of_any_text_are_words(name: str) -> None:
    for word in phrase_words(name):
        assert word.text
        assert not any(c.isspace() for c in word.text)
        assert word.spellings[0] == word.text


# Means, and what is not known.


@pytest.mark.parametrize("kind", ["vec", "npz"])
def test_every_format_gives_the_same_phrases(tmp_path: Path, kind: str) -> None:
    path = tmp_path / f"words.{kind}"
    if kind == "vec":
        written(path, vec_text(VECTORS))
    else:
        word_table(path)
    names = ["trash_can", "Chairs", "T-shirt", "polaroid", "tv", "wooden chair", "cafés", "mug's box"]
    vectors = open_vectors(path)
    assert (vectors.name, vectors.dimension, vectors.kind) == (path.name, 5, "word")
    table = vectors.phrases(names)
    parts = ["trash can", "chair", "t shirt", "Polaroid", "TV", "chair", "café", "mug box"]
    expected = [np.mean([VECTORS[w] for w in p.split()], axis=0) for p in parts]
    np.testing.assert_allclose(table, expected, atol=1e-6)
    assert table.dtype == np.float32


def test_normalised_mean_is_of_unit_vectors(vec: Path) -> None:
    got = open_vectors(vec).phrases(["trash can"], normalised=True)[0]
    a, b = VECTORS["trash"], VECTORS["can"]
    np.testing.assert_allclose(got, (a / np.linalg.norm(a) + b / np.linalg.norm(b)) / 2, atol=1e-6)


@given(st.lists(st.floats(1e-30, 1e30), min_size=2, max_size=2), st.integers(0, 2**32 - 1))
def test_lengths_do_not_count_in_the_normalised_mean(scales: list[float], seed: int) -> None:
    rows = np.random.default_rng(seed).normal(size=(2, 4)).astype(np.float32)
    scaled = rows * np.array(scales, np.float32)[:, None]
    one, other = (VectorTable(Path("t"), "word", ("red", "mug"), v) for v in (rows, scaled))
    np.testing.assert_allclose(
        one.phrases(["red mug"], normalised=True)[0], other.phrases(["red mug"], normalised=True)[0], atol=1e-5
    )


def test_names_of_which_no_word_is_known_are_an_error(vec: Path) -> None:
    vectors = open_vectors(vec)
    with pytest.raises(InputError, match=r"'frobnicator', '\?\?\?'") as caught:
        vectors.phrases(["mug", "frobnicator", "???", "wooden table"])
    assert "\n" not in str(caught.value)
    np.testing.assert_array_equal(vectors.phrases(["mug", "mug"]), [VECTORS["mug"]] * 2)


def test_a_row_of_zeros_is_no_vector(tmp_path: Path) -> None:
    rows = np.array([[0, 0], [1e-60, 0], [1, 2]])
    np.savez(tmp_path / "t.npz", words=np.array(["mug", "cup", "jar"]), vectors=rows)
    written(tmp_path / "t.vec", vec_text(dict(zip(["mug", "cup", "jar"], rows, strict=True))))
    for name in ("t.npz", "t.vec"):
        with pytest.raises(InputError, match="'mug', 'cup'"):
            open_vectors(tmp_path / name).phrases(["mug", "cup", "jar"])


def test_no_names_and_one_string(vec: Path) -> None:
    assert open_vectors(vec).phrases([]).shape == (0, 5)
    with pytest.raises(InputError, match="sequence"):
        open_vectors(vec).phrases("mug")


@settings(max_examples=30)
@given(st.lists(st.text(max_size=20), max_size=5))
def test_any_names_are_found_or_reported(names: list[str]) -> None:
    vectors = VectorTable(Path("t"), "word", WORDS, np.stack(list(VECTORS.values())))
    for name in names:
        try:
            row = vectors.phrases([name])
        except InputError:
            continue
        assert row.any()


# Text files.


def test_words_are_looked_up_in_one_pass(vec: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    passes: list[set[str]] = []
    scan = VecFile._scan
    monkeypatch.setattr(VecFile, "_scan", lambda self, wanted: passes.append(set(wanted)) or scan(self, wanted))
    vectors = open_vectors(vec)
    vectors.phrases(["mug", "trash can", "red mug"])
    assert vectors.fingerprint() == open_vectors(vec).fingerprint()
    assert passes == [passes[0], set()]


def test_a_changed_file_has_another_fingerprint(vec: Path) -> None:
    before = open_vectors(vec).fingerprint()
    written(vec, vec_text(dict(VECTORS, mug=VECTORS["chair"], chair=VECTORS["mug"])))
    assert open_vectors(vec).fingerprint() != before


def test_packed_text_is_the_same(vec: Path, tmp_path: Path) -> None:
    packed = open_vectors(written(tmp_path / "words.vec.gz", gzip.compress(vec.read_bytes())))
    plain = open_vectors(vec)
    assert packed.fingerprint() == plain.fingerprint()
    np.testing.assert_array_equal(packed.phrases(["trash can"])[0], plain.phrases(["trash can"])[0])


def test_odd_lines_of_text(tmp_path: Path) -> None:
    lines = [
        b"\xef\xbb\xbf7 2",
        b". mug 9 9",
        b"mug at home 8 8",
        b"mug 1 2 ",
        b"mug 7 7",
        b"\xff\xfe bad 6 6",
        b"caf\xc3\xa9 3 4",
        b"\xc2\xa0 5 5",
        b"",
        b"",
    ]
    for end in (b"\n", b"\r\n"):
        path = written(tmp_path / "odd.vec", end.join(lines))
        np.testing.assert_array_equal(open_vectors(path).phrases(["mug", "café"]), [[1, 2], [3, 4]])
        for unknown in ("\ud800", "at\0"):
            with pytest.raises(InputError, match="no word"):
                open_vectors(path).phrases([unknown])


# Tables.


def phrase_table(tmp_path: Path, names: list[str], key: str = "phrases", **more: object) -> VectorFile:
    vectors = np.arange(len(names) * 2, dtype=np.float16).reshape(-1, 2) + 1
    np.savez(tmp_path / "clip.npz", **{key: np.array(names)}, vectors=vectors, **more)  # type: ignore[arg-type]
    return open_vectors(tmp_path / "clip.npz")


@pytest.mark.parametrize("key", ["phrases", "names"])
def test_phrases_are_found_whole_by_their_normal_form(tmp_path: Path, key: str) -> None:
    vectors = phrase_table(tmp_path, ["trash_can", "bat_(animal)", "bookcase", "trash can", "mug", "???"], key)
    assert vectors.kind == "phrase"
    names = ["trash cans", "trash can", "TrashCan", "bat (animal)", "bookcase / shelf", "Mugs"]
    rows = [0, 3, 0, 1, 2, 4]
    np.testing.assert_array_equal(vectors.phrases(names)[:, 0], [2 * r + 1 for r in rows])
    with pytest.raises(InputError, match=r"'trash mug', '!!!'.*whole phrases"):
        vectors.phrases(["trash mug", "mug", "!!!"])
    unit = vectors.phrases(["mug"], normalised=True)[0]
    np.testing.assert_allclose(unit, np.array([9, 10]) / np.hypot(9, 10), atol=1e-6)


def test_whole_names_come_before_means_in_a_table_of_words(tmp_path: Path) -> None:
    vectors = phrase_table(tmp_path, ["trash", "can", "trash_can"], "words")
    np.testing.assert_array_equal(vectors.phrases(["trash cans", "can trash"]), [[5, 6], [2, 3]])


def test_kind_is_what_the_file_says(tmp_path: Path) -> None:
    assert phrase_table(tmp_path, ["red", "mug"], "phrases", kind="word").kind == "word"
    assert phrase_table(tmp_path, ["red", "mug"], "words", kind="phrase").kind == "phrase"
    np.testing.assert_array_equal(phrase_table(tmp_path, ["red", "mug"], "words").phrases(["red mug"])[0], [2, 3])
    with pytest.raises(InputError, match="'sentence'"):
        phrase_table(tmp_path, ["mug"], kind="sentence")


def test_fingerprint_of_a_table_is_of_its_content(tmp_path: Path) -> None:
    one = open_vectors(word_table(tmp_path / "a.npz")).fingerprint()
    rows = np.stack(list(VECTORS.values()))
    np.savez_compressed(tmp_path / "b.npz", kind="word", vectors=rows, words=np.array(WORDS))
    assert open_vectors(tmp_path / "b.npz").fingerprint() == one
    np.savez(tmp_path / "c.npz", vectors=rows + np.float32(1e-6), words=np.array(WORDS))
    assert open_vectors(tmp_path / "c.npz").fingerprint() != one
    np.savez(tmp_path / "d.npz", vectors=rows, words=np.array([*WORDS[:-1], "other"]))
    assert open_vectors(tmp_path / "d.npz").fingerprint() != one


def test_first_of_two_equal_names_counts(tmp_path: Path) -> None:
    assert phrase_table(tmp_path, ["mug", "mug"]).phrases(["mug"])[0][0] == 1


def test_real_tables(shared_data: Path, tmp_path: Path) -> None:
    clip = open_vectors(shared_data / "vectors" / "clip_vitb32_object_names.npz")
    assert (clip.kind, clip.dimension) == ("phrase", 512)
    assert isinstance(clip, VectorTable)
    table = clip.phrases(clip.names)
    with np.load(shared_data / "vectors" / "clip_vitb32_object_names.npz") as data:
        # Names that stand in it for several datasets differ by rounding only.
        np.testing.assert_allclose(table, data["vectors"], atol=0.01)
    with np.load(shared_data / "vectors" / "fasttext300_object_names.npz") as data:
        np.savez(tmp_path / "words.npz", words=data["names"], vectors=data["vectors"])
    fast = open_vectors(tmp_path / "words.npz")
    assert fast.dimension == 300
    near, far = (fast.phrases(pair, normalised=True) for pair in (["chair", "table"], ["chair", "airplane"]))
    assert near[0] @ near[1] > far[0] @ far[1]


# The contract of a network.


def test_contract_goes_through_metadata(vec: Path, tmp_path: Path) -> None:
    vectors = open_vectors(vec)
    contract = LanguageContract.of(vectors, normalised=True)
    metadata = contract.to_metadata()
    assert all(isinstance(v, str) for v in metadata.values())
    assert LanguageContract.from_metadata({**metadata, "srm.features": "rel14"}) == contract
    assert LanguageContract.from_metadata({"srm.features": "rel14"}) is None
    contract.check(vectors)
    contract.check(open_vectors(written(tmp_path / "renamed.vec", vec.read_bytes())))


def test_wrong_vectors_are_refused(vec: Path, tmp_path: Path) -> None:
    contract = LanguageContract.of(open_vectors(vec))
    other = open_vectors(written(tmp_path / "other.vec", vec_text({**VECTORS, "mug": VECTORS["can"]})))
    with pytest.raises(InputError, match="other ones"):
        contract.check(other)
    with pytest.raises(InputError, match="another dimension"):
        replace(contract, dimension=300).check(open_vectors(vec))


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("contract", "spatialviz-language-9"),
        ("dimension", "many"),
        ("dimension", "0"),
        ("normalised", "perhaps"),
        ("fingerprint", ""),
        ("fingerprint", None),
        ("name", None),
        ("contract", None),
    ],
)
def test_metadata_that_makes_no_sense_is_refused(key: str, value: str | None) -> None:
    metadata = LanguageContract("words.vec", 5, False, "abc").to_metadata()
    metadata.pop(f"srm.language.{key}")
    if value is not None:
        metadata[f"srm.language.{key}"] = value
    with pytest.raises(InputError, match="language features"):
        LanguageContract.from_metadata(metadata)
