"""Tiny open-vocabulary networks of the reference library, with random weights, and their ONNX exports."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from onnx_stubs import bert_vocabulary
from reference_code import import_reference

import_reference("transformers")

from transformers import (  # noqa: E402
    BertConfig,
    BertTokenizer,
    CLIPTokenizer,
    GroundingDinoConfig,
    GroundingDinoForObjectDetection,
    Owlv2Config,
    Owlv2ForObjectDetection,
    OwlViTConfig,
    OwlViTForObjectDetection,
    SwinConfig,
)
from transformers.models.grounding_dino import modeling_grounding_dino as reference  # noqa: E402

HEIGHT, WIDTH = 96, 128
SIDE = 96


@dataclass(frozen=True)
class Export:
    """A reference model, its tokenizer, and its ONNX file in a folder with the tokenizer's own file."""

    model: Any
    tokenizer: Any
    path: Path


def grounding_dino(folder: Path) -> tuple[Any, Any]:
    """The reference model and its tokenizer, whose file is written to the folder."""
    torch.manual_seed(0)
    swin: Any = SwinConfig
    config = GroundingDinoConfig(
        backbone_config=swin(
            image_size=64,
            embed_dim=12,
            depths=[1, 1, 1],
            num_heads=[1, 1, 2],
            window_size=4,
            out_features=["stage2", "stage3"],
        ),
        text_config=BertConfig(
            vocab_size=1100,
            hidden_size=32,
            num_hidden_layers=1,
            num_attention_heads=2,
            intermediate_size=32,
            max_position_embeddings=256,
        ),
        num_feature_levels=3,
        encoder_n_points=2,
        decoder_n_points=2,
        num_queries=60,
        d_model=32,
        encoder_layers=1,
        decoder_layers=2,
        encoder_ffn_dim=32,
        decoder_ffn_dim=32,
        encoder_attention_heads=2,
        decoder_attention_heads=2,
        disable_custom_kernels=True,
    )
    tokenizer = BertTokenizer(vocab=bert_vocabulary(), do_lower_case=True)
    tokenizer.backend_tokenizer.save(str(folder / "tokenizer.json"))
    return GroundingDinoForObjectDetection(config).eval(), tokenizer


def token_masks(input_ids: torch.Tensor, special_tokens: torch.Tensor) -> tuple[torch.Tensor, torch.Tensor]:
    """The reference's text masks in operators that have an ONNX form."""
    size = input_ids.shape[1]
    special = (input_ids[..., None] == special_tokens).any(-1).long()
    place = torch.arange(size)
    block = torch.cumsum(special, 1) - special
    inside = (block > 0) & (block < special.sum(1, keepdim=True)) & ~(special.bool() & (place == size - 1))
    same = (block[:, :, None] == block[:, None, :]) & inside[:, None, :] & inside[:, :, None]
    positions = torch.where(inside, (same & (place[None, None, :] < place[None, :, None])).long().sum(2), 0)
    return same | (place[:, None] == place[None, :])[None], positions


def _linspace(start: float, end: float, steps: int, dtype: Any = None, device: Any = None) -> torch.Tensor:
    # The exporter makes float64 of torch.linspace, which ONNX Runtime cannot sample a grid at.
    return torch.arange(int(steps), dtype=torch.float32) + float(start)


@contextmanager
def _exportable(masks: Any) -> Iterator[None]:
    kept = reference.generate_masks_with_special_tokens_and_transfer_map, torch.linspace
    reference.generate_masks_with_special_tokens_and_transfer_map, torch.linspace = masks, _linspace
    try:
        yield
    finally:
        reference.generate_masks_with_special_tokens_and_transfer_map, torch.linspace = kept


class _Grounding(torch.nn.Module):
    def __init__(self, model: Any) -> None:
        super().__init__()
        self.model = model

    def forward(self, pixels: Any, ids: Any, types: Any, valid: Any, pixel_mask: Any) -> Any:
        found = self.model(
            pixel_values=pixels, input_ids=ids, token_type_ids=types, attention_mask=valid, pixel_mask=pixel_mask
        )
        return found.logits, found.pred_boxes


class _GroundingFromOutside(torch.nn.Module):
    """As the original code's export: the blocks of tokens are inputs."""

    def __init__(self, model: Any) -> None:
        super().__init__()
        self.model = model

    def forward(self, pixels: Any, ids: Any, valid: Any, types: Any, positions: Any, blocks: Any) -> Any:
        self.blocks = blocks, positions
        found = self.model(pixel_values=pixels, input_ids=ids, token_type_ids=types, attention_mask=valid.long())
        return found.logits, found.pred_boxes


def export_grounding_dino(model: Any, path: Path, *, outside: bool = False) -> None:
    """Write the transformers contract, or the one of the original code (`outside`)."""
    ids = torch.tensor([[101, 200, 201, 1012, 202, 1012, 102]])
    pixels, ones = torch.randn(1, 3, HEIGHT, WIDTH), torch.ones_like(ids)
    if outside:
        blocks, positions = token_masks(ids, torch.tensor([101, 102, 1012, 1029]))
        wrapper: Any = _GroundingFromOutside(model).eval()
        args: Sequence[Any] = (pixels, ids, ones.bool(), ones * 0, positions, blocks)
        names = ["img", "input_ids", "attention_mask", "token_type_ids", "position_ids", "text_token_mask"]
        masks: Any = lambda input_ids, special_tokens: wrapper.blocks  # noqa: E731
    else:
        wrapper, masks = _Grounding(model).eval(), token_masks
        args = (pixels, ids, ones * 0, ones, torch.ones(1, HEIGHT, WIDTH, dtype=torch.long))
        names = ["pixel_values", "input_ids", "token_type_ids", "attention_mask", "pixel_mask"]
    axes = {n: {1: "sequence_length"} for n in names if "ids" in n or n == "attention_mask"}
    axes |= {"text_token_mask": {1: "sequence_length", 2: "sequence_length"}} if outside else {}
    with _exportable(masks):
        _export(wrapper, args, path, names, ["logits", "pred_boxes"], axes)


def byte_pairs() -> tuple[dict[str, int], list[tuple[str, str]]]:
    """A CLIP vocabulary of letters and three words, and its merges."""
    letters = [chr(c) for c in range(33, 127)]
    merges = [("m", "u"), ("mu", "g</w>"), ("o", "f</w>"), ("d", "o"), ("do", "g</w>")]
    tokens = [*letters, *(c + "</w>" for c in letters), *("".join(m) for m in merges)]
    tokens += ["<|startoftext|>", "<|endoftext|>"]
    return {t: n for n, t in enumerate(tokens)}, merges


def owl(kind: str, folder: Path) -> tuple[Any, Any]:
    """The reference model of that kind and its tokenizer, whose file is written to the folder."""
    vocabulary, merges = byte_pairs()
    torch.manual_seed(1)
    config_of: Any = Owlv2Config if kind == "owlv2" else OwlViTConfig
    model_of: Any = Owlv2ForObjectDetection if kind == "owlv2" else OwlViTForObjectDetection
    size = len(vocabulary)
    config = config_of(
        text_config={
            "vocab_size": size,
            "hidden_size": 32,
            "intermediate_size": 32,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "max_position_embeddings": 16,
            "bos_token_id": size - 2,
            "eos_token_id": size - 1,
        },
        vision_config={
            "hidden_size": 32,
            "intermediate_size": 32,
            "num_hidden_layers": 2,
            "num_attention_heads": 2,
            "image_size": SIDE,
            "patch_size": 16,
        },
        projection_dim=32,
    )
    model = model_of(config).eval()
    with torch.no_grad():
        # At the random start all scores are 0 or 1 and all boxes the whole picture.
        for layer in (model.class_head.logit_shift, model.class_head.logit_scale, model.box_head.dense2):
            layer.weight.mul_(0.03)
    tokenizer_of: Any = CLIPTokenizer
    tokenizer = tokenizer_of(vocab=vocabulary, merges=merges, pad_token="!")
    tokenizer.backend_tokenizer.save(str(folder / "tokenizer.json"))
    return model, tokenizer


class _Owl(torch.nn.Module):
    def __init__(self, model: Any) -> None:
        super().__init__()
        self.model = model

    def forward(self, ids: Any, pixels: Any, valid: Any) -> Any:
        found = self.model(input_ids=ids, pixel_values=pixels, attention_mask=valid)
        more = () if found.get("objectness_logits") is None else (found.objectness_logits,)
        return (found.logits, found.pred_boxes, found.text_embeds, found.image_embeds, *more)


def export_owl(model: Any, path: Path, *, names: int | None = None) -> None:
    """Write the contract of transformers.js and optimum, for any number of names or for exactly that one."""
    size = model.config.text_config.vocab_size
    rows = names or 2
    ids = torch.tensor([[size - 2, 5, 6, size - 1] + [0] * 12] * rows)
    outputs = ["logits", "pred_boxes", "text_embeds", "image_embeds"]
    outputs += ["objectness_logits"] if hasattr(model, "objectness_head") else []
    axes = {"input_ids": {0: "names"}, "attention_mask": {0: "names"}, "logits": {2: "names"}}
    inputs = ["input_ids", "pixel_values", "attention_mask"]
    args = (ids, torch.randn(1, 3, SIDE, SIDE), (ids > 0).long())
    _export(_Owl(model).eval(), args, path, inputs, outputs, axes if names is None else {})


def _export(model: Any, args: Sequence[Any], path: Path, inputs: list[str], outputs: list[str], axes: Any) -> None:
    import warnings

    with warnings.catch_warnings(), torch.no_grad():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            model,
            tuple(args),
            str(path),
            input_names=inputs,
            output_names=outputs,
            opset_version=17,
            dynamo=False,
            dynamic_axes=axes,
        )
