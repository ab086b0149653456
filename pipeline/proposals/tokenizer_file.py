"""The tokenizer that belongs to a model: found beside its file, and read without the network."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from pipeline.system.errors import InputError, MissingExtra
from pipeline.system.onnx_session import first_line

TOKENIZER = "tokenizer.json"


def find_tokenizer(model: Path, patterns: Sequence[str] = (TOKENIZER,)) -> Path:
    """The tokenizer's file in the model's folder or in the one above it, as the model hubs lay them out.

    Parameters
    ----------
    model : Path
        The ONNX file.
    patterns : sequence of str
        File names or globs, the best first.

    Raises
    ------
    InputError
        Where there is none, or several fit the same pattern.
    """
    for folder in (model.parent, model.resolve().parent.parent):
        for pattern in patterns:
            found = sorted(p for p in folder.glob(pattern) if p.is_file())
            if len(found) > 1:
                names = ", ".join(p.name for p in found[:4])
                raise InputError("several tokenizers stand beside the model", got=names, expected="one", path=folder)
            if found:
                return found[0]
    raise InputError(
        "there is no tokenizer for the model",
        expected=f"{' or '.join(patterns)} in its folder or the one above",
        cause="it is published with the model",
        path=model,
    )


def load_tokenizer(path: Path) -> Any:
    """A `tokenizers.Tokenizer` that neither pads nor cuts, and takes what a user types for text only.

    Parameters
    ----------
    path : Path
        A tokenizer.json, or the vocabulary of an uncased BERT with one word piece a line (.txt).

    Raises
    ------
    InputError
        Where the file is missing or cannot be read.
    MissingExtra
        Where the library `tokenizers` is not installed.
    """
    try:
        import tokenizers
    except ImportError as error:
        raise MissingExtra("a detector that reads text", "hub") from error
    if not path.is_file():
        raise InputError("there is no tokenizer file", path=path)
    try:
        tokenizer = _word_pieces(path) if path.suffix == ".txt" else tokenizers.Tokenizer.from_file(str(path))
    except Exception as error:  # The library raises bare Exceptions.
        raise InputError("the tokenizer cannot be read", got=first_line(error), path=path) from error
    tokenizer.no_padding()
    tokenizer.no_truncation()
    # A class name "[SEP]" must not end the sentence.
    tokenizer.encode_special_tokens = True
    return tokenizer


def _word_pieces(path: Path) -> Any:
    from tokenizers import Tokenizer, models, normalizers, pre_tokenizers

    tokenizer = Tokenizer(models.WordPiece.from_file(str(path), unk_token="[UNK]"))
    tokenizer.normalizer = normalizers.BertNormalizer(lowercase=True)
    tokenizer.pre_tokenizer = pre_tokenizers.BertPreTokenizer()
    return tokenizer
