"""A picture encoder and a prompt decoder in two ONNX files: opened together, checked against each other."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.proposals.contracts import Contract, _fits, by_name, follows
from pipeline.proposals.mismatch import explain_mismatch, shapes
from pipeline.proposals.prompted import stretched
from pipeline.system.errors import InputError, require
from pipeline.system.onnx_session import as_declared, model_hash, open_session, signature


class PairModel:
    """Two sessions that belong together.

    Parameters
    ----------
    paths : sequence of Path
        The encoder, then the decoder.

    Attributes
    ----------
    encoders, decoders : sequence of Contract
        Those that will do.
    encoder_path, decoder_path : Path
    encoder_input : TensorSpec
        The picture, as the encoder declares it.
    decoder_inputs, decoder_outputs : dict of str to TensorSpec
        As the decoder declares them, by name.
    features : dict of str to str
        Which input of the decoder each output of the encoder goes to.

    Raises
    ------
    InputError
        There are not two files, one is of another kind, they are the wrong way
        round, or they do not fit each other.
    """

    name: str
    version = "1"
    encoders: Sequence[Contract]
    decoders: Sequence[Contract]

    def __init__(self, paths: Sequence[Path]) -> None:
        option = self.encoders[0].option
        require(
            len(paths) == 2,
            f"{option} needs two model files",
            got=" ".join(str(p) for p in paths) or None,
            expected="--segmenter-model ENCODER.onnx DECODER.onnx",
        )
        self.encoder_path, self.decoder_path = paths
        self._encoder, self._decoder = open_session(self.encoder_path), open_session(self.decoder_path)
        encoder, decoder = _follows(self._encoder, self.encoders), _follows(self._decoder, self.decoders)
        turned = _follows(self._encoder, self.decoders), _follows(self._decoder, self.encoders)
        require(
            encoder is not None or decoder is not None or not all(turned),
            "encoder and decoder are the wrong way round",
            got=f"{paths[0].name} is the decoder, {paths[1].name} the encoder",
            expected=f"--segmenter-model {paths[1].name} {paths[0].name}",
        )
        if encoder is None:
            raise _not_fitting(option, "encoder", self._encoder, paths[0], self.encoders, turned[0])
        if decoder is None:
            raise _not_fitting(option, "decoder", self._decoder, paths[1], self.decoders, turned[1])
        (self.encoder_input,) = by_name(self._encoder.get_inputs()).values()
        self.decoder_inputs, self.decoder_outputs = (
            by_name(values) for values in (self._decoder.get_inputs(), self._decoder.get_outputs())
        )
        given, wanted = by_name(self._encoder.get_outputs()), [s.name for s in encoder.outputs]
        # The only output of an encoder may bear any name.
        one = len(wanted) == len(given) == 1
        self.features = {next(iter(given)): wanted[0]} if one else {n: n for n in wanted}
        for source, target in self.features.items():
            spec = self.decoder_inputs.get(target)
            # As far as both declare them.
            require(
                spec is not None and _fits(given[source], spec),
                "encoder and decoder do not belong together",
                got=f"the encoder {self.encoder_path.name} gives {given[source].name} {list(given[source].shape)}",
                expected=shapes((spec,)) if spec else ", ".join(self.decoder_inputs),
                cause="are they of the same export?",
                path=self.decoder_path,
            )

    @cached_property
    def _hash(self) -> str:
        return f"{model_hash(self.encoder_path)}:{model_hash(self.decoder_path)}"

    def fingerprint(self) -> str:
        """Content of both files, with weights that are in files of their own, and the version of the code here."""
        return f"{self.name}:{self.version}:{self._hash}"

    def boxes_at_once(self, height: int, width: int) -> int:
        """How many boxes the decoder may take in a run, by what it declares."""
        return 1

    def to_picture(self, logits: np.ndarray, height: int, width: int) -> np.ndarray:
        """(height, width) float32 mask logits of one box ((h, w) float32)."""
        return logits if logits.shape == (height, width) else stretched(logits, height, width)

    def _encoded(self, image: np.ndarray) -> dict[str, np.ndarray]:
        """Features of a picture, as the encoder's contract says it, by the decoder's names for them."""
        values = run(self._encoder, list(self.features), {self.encoder_input.name: image}, self.encoder_path)
        return dict(zip(self.features.values(), values, strict=True))

    def _decoded(self, feed: dict[str, np.ndarray], outputs: Sequence[str]) -> list[np.ndarray]:
        """The decoder's outputs as float32."""
        feed = {n: feed[n] for n in self.decoder_inputs}
        return [o.astype(np.float32, copy=False) for o in run(self._decoder, outputs, feed, self.decoder_path)]


def run(session: Any, outputs: Sequence[str], feed: dict[str, np.ndarray], path: Path) -> list[np.ndarray]:
    """Run a session on inputs converted to the types that the file declares.

    Raises
    ------
    InputError
        An input cannot be converted, ONNX Runtime refuses the input, or fails inside the model.
    """
    feed = as_declared(session, feed, path)
    try:
        return session.run(list(outputs), feed)
    except Exception as error:  # ONNX Runtime raises its own classes, which differ between releases.
        first = str(error).splitlines()[0] if str(error) else type(error).__name__
        given = ", ".join(f"{n} {list(v.shape)}" for n, v in feed.items())
        raise InputError("the model cannot be run", got=f"{first[:160]} for {given}", path=path) from error


def _follows(session: Any, contracts: Sequence[Contract]) -> Contract | None:
    return next((c for c in contracts if follows(session, c)), None)


def _not_fitting(
    option: str, role: str, session: Any, path: Path, wanted: Sequence[Contract], other: Contract | None
) -> InputError:
    """The error for a file of another kind; it says which kind that is, where it is known."""
    found = "a decoder" if role == "encoder" else "an encoder"
    return InputError(
        f"the ONNX file is not the {role} that {option} reads",
        got=signature(session)[:240],
        expected=" or ".join(dict.fromkeys(shapes(c.inputs) for c in wanted)),
        cause=explain_mismatch(session, option) if other is None else f"this is {found}: the other file is missing",
        path=path,
    )
