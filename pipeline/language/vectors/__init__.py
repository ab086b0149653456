"""Language features: vectors of class names out of a file of word or sentence vectors."""

from __future__ import annotations

from pathlib import Path

from pipeline.language.vectors.contract import LanguageContract
from pipeline.language.vectors.phrases import VectorFile
from pipeline.language.vectors.tables import read_json, read_npz
from pipeline.system.errors import InputError, require

__all__ = ["LanguageContract", "VectorFile", "open_vectors"]

FORMATS = ".vec, .vec.gz, .bin, .npz, .json"


def open_vectors(path: str | Path) -> VectorFile:
    """Open a file of text vectors, in the format of the file's ending.

    ========== ==================================================================================================
    .vec       FastText's text format, also gzipped (.vec.gz): read once for all the words asked for, then cached
    .bin       FastText's binary model, with subwords: mapped, never loaded
    .npz       `words` (or `phrases`, or `names`) of unicode and `vectors` (N, D) of floats; a `kind`
    .json      {"kind": "word" | "phrase", "vectors": {name: [D numbers], ...}}
    ========== ==================================================================================================

    Entries of kind "word" may be averaged over a phrase; whole phrases (CLIP, MiniLM) may not.

    Raises
    ------
    InputError
        There is no such file, the format is not known, or the file is damaged.

    >>> import tempfile
    >>> from pathlib import Path
    >>> from pipeline.language import open_vectors
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     path = Path(folder, "words.json")
    ...     _ = path.write_text('{"kind": "word", "vectors": {"coffee": [1, 0], "table": [0, 1]}}')
    ...     print(open_vectors(path).phrases(["CoffeeTables"]))
    [[0.5 0.5]]
    """
    path = Path(path)
    require(path.is_file(), "there is no file of text vectors", expected=FORMATS, path=path)
    name = path.name.lower()
    if name.endswith((".vec", ".vec.gz")):
        from pipeline.language.vectors.vec_text import VecFile

        return VecFile.open(path)
    if name.endswith(".bin"):
        from pipeline.language.vectors.fasttext_bin import FastTextBinary

        return FastTextBinary.open(path)
    if name.endswith((".npz", ".json")):
        return (read_npz if name.endswith(".npz") else read_json)(path)
    causes = {".ftz": "a quantised model; take the .bin or .vec it was made from", ".gz": "unpack it first"}
    raise InputError(
        "the format of the text vectors is not known",
        got=repr(path.suffix),
        expected=FORMATS,
        cause=causes.get(path.suffix.lower()),
        path=path,
    )
