"""Prompts for open-vocabulary networks: GroundingDINO's captions ("mug. laptop.", with the tokens of every name), and
tokenizers next to model files."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.system.errors import InputError, as_input_error, extra_module, first_line, require
from pipeline.system.safe_files import checked_path

MAX_TOKENS = 256
SPECIAL = {"[CLS]": 101, "[SEP]": 102, ".": 1012, "?": 1029}
"""The tokens that part a caption, by the numbers that the network has built in."""
_CLS, _SEP, _STOP = 101, 102, 1012
_SEPARATORS = re.compile(r"[.?]")
_GAPS = re.compile(r"[\s_]+")


@dataclass(frozen=True)
class Caption:
    """Caption of a single run."""

    text: str
    ids: np.ndarray  # (S,) int64: Tokens, with those that begin and end the text
    names: np.ndarray  # (N,) int64: Which of the names asked for, in their order in the text
    spans: np.ndarray  # (N, 2) int64: The first token of each name, and the one after its last


def plain_name(name: str) -> str:
    """Class name as in captions: lower case, no separators (`T.V._stand` becomes `tv stand`)."""
    return _GAPS.sub(" ", _SEPARATORS.sub("", name)).strip().lower()


def check_bert(tokenizer: Any, path: Path) -> None:
    """Raise InputError unless token numbers are those of uncased BERT, as in GroundingDINO."""
    found = {token: tokenizer.token_to_id(token) for token in SPECIAL}
    require(
        found == SPECIAL,
        "the tokenizer is not the one of GroundingDINO",
        got=", ".join(f"{t} = {n}" for t, n in found.items()),
        expected=", ".join(f"{t} = {n}" for t, n in SPECIAL.items()),
        cause="it must be that of bert-base-uncased",
        path=path,
    )
    require(
        tokenizer.token_to_id("[UNK]") is not None,
        "the tokenizer has no token for unknown words",
        expected="[UNK]",
        path=path,
    )


def build_captions(names: Sequence[str], tokenizer: Any, limit: int = MAX_TOKENS) -> list[Caption]:
    """Fewest captions holding all names in order, at most `limit` tokens each; names are never cut. Names that read the
    same stand in a caption once, for the first of them."""
    groups: list[list[tuple[int, str, list[int]]]] = [[]]
    length = 2
    seen: set[str] = set()
    for number, name in enumerate(names):
        plain = plain_name(name)
        if plain in seen:
            continue
        seen.add(plain)
        tokens = _tokens(name, plain, tokenizer, limit)
        if length + len(tokens) + 1 > limit:
            groups.append([])
            length = 2
        groups[-1].append((number, plain, tokens))
        length += len(tokens) + 1
    return [_caption(group) for group in groups if group]


def _tokens(name: str, plain: str, tokenizer: Any, limit: int) -> list[int]:
    require(plain, "a name has no words that can be looked for", got=repr(name[:60]))
    tokens = tokenizer.encode(plain, add_special_tokens=False).ids
    unknown = tokenizer.token_to_id("[UNK]")
    require(
        tokens and not all(t == unknown for t in tokens),
        "the model's tokenizer knows no word of a name",
        got=repr(name[:60]),
    )
    require(not set(tokens) & set(SPECIAL.values()), "a name holds a mark that parts names", got=repr(name[:60]))
    require(
        len(tokens) + 3 <= limit,
        "a name is too long for the model",
        got=f"{len(tokens)} tokens in {name[:40]!r}",
        expected=f"at most {limit - 3}",
    )
    return tokens


def _caption(group: list[tuple[int, str, list[int]]]) -> Caption:
    ids = [_CLS]
    spans = []
    for _, _, tokens in group:
        spans.append((len(ids), len(ids) + len(tokens)))
        ids += [*tokens, _STOP]
    return Caption(
        ". ".join(plain for _, plain, _ in group) + ".",
        np.array([*ids, _SEP], np.int64),
        np.array([number for number, _, _ in group], np.int64),
        np.array(spans, np.int64),
    )


def token_blocks(ids: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Attention mask and positions of tokens: each name separately, with the following stop.

    As `generate_masks_with_special_tokens_and_transfer_map` of IDEA-Research/GroundingDINO (bertwarper.py): a block
    ends with its special token, which belongs to it; the first and the last token, and those behind the last special
    one, attend to themselves.

    `ids` (S,) int64; `positions` (S,) int64: Counted from 0 in each block.
    """
    special = np.isin(ids, list(SPECIAL.values()))
    block = np.cumsum(special) - special
    last = len(ids) - 1
    closed = np.append(np.flatnonzero(special), len(ids))[block]
    inside = (closed > 0) & (closed < last)
    mask = (block[:, None] == block[None, :]) & inside[:, None]
    np.fill_diagonal(mask, True)
    begins = np.append(0, np.flatnonzero(special) + 1)[block]
    return mask, np.where(inside, np.arange(len(ids)) - begins, 0)


def span_scores(probabilities: np.ndarray, spans: np.ndarray) -> np.ndarray:
    """(Q, N): the greatest probability of each name's tokens, of (Q, S) probabilities and (N, 2) spans."""
    edges = spans.reshape(-1)
    # Each name is followed by its stop, so that the maxima between spans are those of single tokens, left out.
    return np.maximum.reduceat(probabilities, edges, axis=1)[:, ::2]


def sigmoid(logits: np.ndarray) -> np.ndarray:
    """1 / (1 + exp(-x)) in float32 for any x, the infinities included."""
    # Beyond 88 the exponential of float32 is infinite.
    return (0.5 * (1 + np.tanh(np.clip(logits.astype(np.float64), -80, 80) / 2))).astype(np.float32)


TOKENIZER = "tokenizer.json"


def find_tokenizer(model: Path, patterns: Sequence[str] = (TOKENIZER,)) -> Path:
    """Tokenizer file in the model's folder or the parent folder, as on model hubs."""
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
    """Load a `tokenizers.Tokenizer` without padding, truncation and special tokens in text."""
    tokenizers = extra_module("tokenizers", "a detector that reads text", "hub")
    require(path.is_file(), "there is no tokenizer file", path=path)
    # The library raises bare Exceptions.
    with as_input_error("the tokenizer cannot be read", Exception, got=first_line, path=path):
        file = checked_path(path, "text")
        tokenizer = _word_pieces(file) if file.suffix == ".txt" else tokenizers.Tokenizer.from_file(str(file))
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
