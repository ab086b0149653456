"""A picture encoder and a prompt decoder in two ONNX files: opened together, checked against each other."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pipeline.proposals.contracts import Contract, TensorSpec, _fits, declared, follows
from pipeline.system.errors import InputError
from pipeline.system.onnx_session import as_declared, model_hash, open_session, signature


@dataclass(frozen=True, eq=False)
class ModelPair:
    """Two sessions that belong together.

    Attributes
    ----------
    encoder_path, decoder_path : Path
    encoder_session, decoder_session : onnxruntime.InferenceSession
    encoder, decoder : Contract
        The one that each file follows.
    """

    encoder_path: Path
    decoder_path: Path
    encoder_session: Any
    decoder_session: Any
    encoder: Contract
    decoder: Contract

    @cached_property
    def content_hash(self) -> str:
        """Of both files, with weights that are in files of their own."""
        return f"{model_hash(self.encoder_path)}:{model_hash(self.decoder_path)}"

    @cached_property
    def encoder_inputs(self) -> dict[str, TensorSpec]:
        """As the encoder declares them, by name."""
        return {s.name: s for s in declared(self.encoder_session.get_inputs())}

    @cached_property
    def decoder_inputs(self) -> dict[str, TensorSpec]:
        """As the decoder declares them, by name."""
        return {s.name: s for s in declared(self.decoder_session.get_inputs())}

    @cached_property
    def features(self) -> dict[str, str]:
        """Which input of the decoder each output of the encoder goes to."""
        outputs = [o.name for o in self.encoder_session.get_outputs()]
        wanted = [s.name for s in self.encoder.outputs]
        # The only output of an encoder may bear any name.
        return {outputs[0]: wanted[0]} if len(wanted) == len(outputs) == 1 else {n: n for n in wanted}

    def encode(self, image: np.ndarray) -> dict[str, np.ndarray]:
        """Features of a picture, by the decoder's names for them.

        Parameters
        ----------
        image : ndarray
            As the encoder's contract says.
        """
        (spec,) = self.encoder_inputs.values()
        values = run(self.encoder_session, list(self.features), {spec.name: image}, self.encoder_path)
        return dict(zip(self.features.values(), values, strict=True))

    def decode(self, feed: dict[str, np.ndarray], outputs: Sequence[str]) -> list[np.ndarray]:
        """The decoder's outputs as float32."""
        feed = {n: feed[n] for n in self.decoder_inputs}
        return [o.astype(np.float32, copy=False) for o in run(self.decoder_session, outputs, feed, self.decoder_path)]

    def decoder_outputs(self) -> dict[str, TensorSpec]:
        """As the decoder declares them, by name."""
        return {s.name: s for s in declared(self.decoder_session.get_outputs())}


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
        shapes = ", ".join(f"{n} {list(v.shape)}" for n, v in feed.items())
        raise InputError("the model cannot be run", got=f"{first[:160]} for {shapes}", path=path) from error


def open_pair(
    option: str, paths: Sequence[Path], encoders: Sequence[Contract], decoders: Sequence[Contract]
) -> ModelPair:
    """Open an encoder and a decoder.

    Parameters
    ----------
    option : str
        For messages, such as "--segmenter sam".
    paths : sequence of Path
        The encoder, then the decoder.
    encoders, decoders : sequence of Contract
        Those that will do.

    Raises
    ------
    InputError
        There are not two files, one is of another kind, they are the wrong way
        round, or they do not fit each other.
    """
    if len(paths) != 2:
        raise InputError(
            f"{option} needs two model files",
            got=" ".join(str(p) for p in paths) or None,
            expected="--segmenter-model ENCODER.onnx DECODER.onnx",
        )
    sessions = [open_session(p) for p in paths]
    kinds = [
        next((c for c in wanted if follows(session, c)), None)
        for session, wanted in zip(sessions, (encoders, decoders), strict=True)
    ]
    encoder, decoder = kinds
    if encoder is None and decoder is None and _any(sessions[0], decoders) and _any(sessions[1], encoders):
        raise InputError(
            "encoder and decoder are the wrong way round",
            got=f"{paths[0].name} is the decoder, {paths[1].name} the encoder",
            expected=f"--segmenter-model {paths[1].name} {paths[0].name}",
        )
    if encoder is None:
        raise _not_fitting(option, "encoder", sessions[0], paths[0], encoders, decoders)
    if decoder is None:
        raise _not_fitting(option, "decoder", sessions[1], paths[1], decoders, encoders)
    pair = ModelPair(paths[0], paths[1], sessions[0], sessions[1], encoder, decoder)
    _check_features(pair)
    return pair


def _any(session: Any, contracts: Sequence[Contract]) -> bool:
    return any(follows(session, c) for c in contracts)


def _check_features(pair: ModelPair) -> None:
    """Raise where the decoder wants other features than the encoder gives, as far as both declare them."""
    outputs = {s.name: s for s in declared(pair.encoder_session.get_outputs())}
    for source, target in pair.features.items():
        given, wanted = outputs[source], pair.decoder_inputs.get(target)
        if wanted is None or not _fits(given, wanted):
            raise InputError(
                "encoder and decoder do not belong together",
                got=f"the encoder {pair.encoder_path.name} gives {given.name} {list(given.shape)}",
                expected=_shapes((wanted,)) if wanted else ", ".join(pair.decoder_inputs),
                cause="are they of the same export?",
                path=pair.decoder_path,
            )


def _shapes(specs: Iterable[TensorSpec]) -> str:
    return ", ".join(f"{s.name} [{', '.join(str(d) for d in s.shape)}]" for s in specs)


def _not_fitting(
    option: str, role: str, session: Any, path: Path, wanted: Sequence[Contract], other: Sequence[Contract]
) -> InputError:
    """The error for a file of another kind; it says which kind that is, where it is known."""
    from pipeline.proposals.mismatch import explain_mismatch

    if _any(session, other):
        found = "decoder" if role == "encoder" else "encoder"
        cause = f"this is {'an' if found == 'encoder' else 'a'} {found}: the other file is missing"
    else:
        cause = explain_mismatch(session, option)
    return InputError(
        f"the ONNX file is not the {role} that {option} reads",
        got=signature(session)[:240],
        expected=" or ".join(dict.fromkeys(_shapes(c.inputs) for c in wanted)),
        cause=cause,
        path=path,
    )
