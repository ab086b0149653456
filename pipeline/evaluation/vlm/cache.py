"""Answers kept on disk, by content: model, prompt, picture, parameters."""

from __future__ import annotations

import hashlib
import json
import os
import tempfile
from dataclasses import asdict
from pathlib import Path
from typing import Any

from pipeline.evaluation.vlm.protocol import Completion, Parameters

_VERSION = "1"
"""Part of every key: a change of what is made of a reply must change it."""


def answer_key(parameters: Parameters, prompt: str, picture: str) -> str:
    """SHA-256 of everything that the answer depends on, hexadecimal.

    The server is no part of it: the same model at another address gives the same answer. So a server that takes any
    name for its one model, as llama.cpp's does, must be given a name that tells its models apart.

    Parameters
    ----------
    picture : str
        Hash of the picture as it is sent.
    """
    content = {"version": _VERSION, "request": parameters.fields(), "prompt": prompt, "picture": picture}
    return hashlib.sha256(json.dumps(content, sort_keys=True).encode("ascii")).hexdigest()


class AnswerCache:
    """One JSON file an answer, below a folder.

    A damaged or unreadable file is a miss, never an error; a folder that cannot be written only means that nothing is
    kept.
    """

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def _path(self, key: str) -> Path:
        return self.folder / key[:2] / f"{key}.json"

    def load(self, key: str) -> tuple[Completion, float] | None:
        """The answer, and the seconds that it took; None where it is not known."""
        try:
            table = json.loads(self._path(key).read_text(encoding="utf-8"))
            answer: dict[str, Any] = table["answer"]
            tokens = [answer[name] for name in ("prompt_tokens", "completion_tokens")]
            seconds = float(table["seconds"])
            finish = answer["finish"]
            sound = isinstance(answer["text"], str) and all(n is None or (type(n) is int and n >= 0) for n in tokens)
            if table["key"] != key or not sound or not (finish is None or isinstance(finish, str)):
                return None
            logprobs = tuple(tuple((str(t), float(p)) for t, p in place) for place in answer["logprobs"])
            return Completion(answer["text"], finish, tokens[0], tokens[1], logprobs), seconds
        except (OSError, ValueError, KeyError, TypeError, RecursionError):
            return None

    def store(self, key: str, prompt: str, parameters: Parameters, answer: Completion, seconds: float) -> None:
        """Keep an answer; the question stands beside it for people who look into the file."""
        path = self._path(key)
        table = {
            "key": key,
            "request": parameters.fields(),
            "prompt": prompt,
            "answer": asdict(answer),
            "seconds": seconds,
        }
        temporary: Path | None = None
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            with tempfile.NamedTemporaryFile(dir=path.parent, suffix=".tmp", delete=False) as file:
                temporary = Path(file.name)
                file.write(json.dumps(table).encode("ascii"))
            os.replace(temporary, path)
        except OSError:
            if temporary is not None:
                temporary.unlink(missing_ok=True)
