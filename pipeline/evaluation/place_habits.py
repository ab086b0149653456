"""Units of places by model, as its makers say: the unit and the order in which each writes its places."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

QWEN_DEFAULT, QWEN_SERVED = 16384, (256, 512, 768, 1024, 1280, 2048, 4096)
"""Tokens (28x28 pixels) that Qwen's processor keeps by default, and what examples and services set (`max_pixels`)."""
TOKEN = 28 * 28
_QWEN_LEAST = 4 * TOKEN

_HABITS: tuple[tuple[str, str, bool, str], ...] = (
    # name of the model, unit, y first, where its makers say so
    (r"molmo-?2|molmo-?point", "thousandths", False, "allenai/Molmo2-8B, model card"),
    (r"molmo", "percent", False, "allenai/Molmo-7B-O-0924, discussion 1"),
    (r"qwen-?3(\.\d)?-?(vl|omni)|qwen-?3\.\d", "thousandths", False, "QwenLM/Qwen3-VL#1486 and its cookbooks"),
    (r"qwen-?2[._]?5-?(vl|omni)", "pixels:qwen", False, "QwenLM/Qwen3-VL#866, #721: pixels of the resized picture"),
    (r"qwen-?(2-?)?vl", "thousandths", False, "QwenLM/Qwen3-VL#866; QwenLM/Qwen-VL, README"),
    (r"gemini", "thousandths", True, "ai.google.dev/gemini-api/docs/image-understanding"),
    (r"robobrain-?2[._]?5", "thousandths", False, "FlagOpen/RoboBrain2.5#2"),
    (r"robobrain", "pixels:qwen", False, "FlagOpen/RoboBrain2.0, of Qwen2.5-VL"),
    (r"paligemma", "1024ths", True, "google-research/big_vision, paligemma README"),
    (r"glm-?4(\.\d)?v|glm-?v", "thousandths", False, "zai-org/GLM-V, README: grounding"),
    (r"intern-?vl", "thousandths", False, "OpenGVLab/InternVL, documentation: grounding"),
    (r"deepseek-?vl-?2", "thousandths", False, "deepseek-ai/DeepSeek-VL2, README"),
    (r"cogvlm|cogagent", "thousandths", False, "THUDM/CogVLM, README: grounding"),
    (r"seed-?1[._]5-?vl", "thousandths", False, "ByteDance-Seed/Seed1.5-VL, cookbook"),
    (r"minicpm-?v", "thousandths", False, "OpenBMB/MiniCPM-V, README"),
    (r"florence", "thousandths", False, "microsoft/Florence-2-large, processor"),
    (r"llava-?(v-?)?1[._]5", "padded", False, "haotian-liu/LLaVA, README: image_aspect_ratio pad"),
    (r"robopoint|robo-?refer|kimi-?vl|moondream|shikra", "shares", False, "the prompts of their repositories"),
)
_FORMS: Mapping[str, tuple[str, bool | None]] = {
    # unit and whether y is first, as the words of an answer suggest; None and "" where they do not
    "box_2d": ("thousandths", True),
    "point": ("thousandths", True),
    "point_2d": ("", False),
    "bbox_2d": ("", False),
    "x= y=": ("percent", False),
    "coords": ("thousandths", False),
    "<box>": ("thousandths", False),
    "(a, b)": ("", False),
}


def habit_of(model: str) -> tuple[str, bool, str] | None:
    """Unit, whether y is first, and the source, of a model by its name; None for a model that is not known."""
    for pattern, unit, y_first, source in _HABITS:
        if re.search(pattern, model.casefold().replace("_", "-")):
            return unit, y_first, source
    return None


def suggested(form: str) -> tuple[str, bool | None]:
    """Unit ("" for none) and whether y is first (None for unknown), as the form of an answer suggests."""
    return _FORMS.get(form, ("", None))


def far_edges(unit: str, size: tuple[int, int]) -> tuple[float, float]:
    """Right and lower edge of a picture of `size` (width, height), pixels, in a unit.

    `unit`: shares, padded (shares of the picture padded to a square), percent, thousandths, 1024ths, pixels. Pixels of
    a resized picture are `pixels:640` (its longer side), `pixels:640x480`, `pixels:qwen` and `pixels:qwen-1280` (as
    `smart_resize` of qwen_vl_utils makes it, by default and with at most so many tokens).
    """
    whole = {"shares": 1.0, "padded": 1.0, "percent": 100.0, "thousandths": 1000.0, "1024ths": 1024.0}.get(unit)
    if whole is not None:
        return whole, whole
    width, height = float(size[0]), float(size[1])
    resized = unit.partition(":")[2]
    if not resized:
        return width, height
    if resized.startswith("qwen"):
        return smart_resize(size, int(resized.partition("-")[2] or QWEN_DEFAULT) * TOKEN)
    sides = [float(side) for side in resized.split("x")]
    if len(sides) == 2:
        return sides[0], sides[1]
    return width * sides[0] / max(size), height * sides[0] / max(size)


def smart_resize(size: tuple[int, int], most: int) -> tuple[float, float]:
    """Size that Qwen2.5-VL sees of a picture (qwen_vl_utils.vision_process.smart_resize): multiples of 28 pixels.

    `size`: width and height. `most`: pixels that are kept.
    """
    width, height = (max(28, round(side / 28) * 28) for side in size)
    if width * height > most:
        shrink = math.sqrt(size[0] * size[1] / most)
        width, height = (max(28, math.floor(side / shrink / 28) * 28) for side in size)
    elif width * height < _QWEN_LEAST:
        grow = math.sqrt(_QWEN_LEAST / (size[0] * size[1]))
        width, height = (math.ceil(side * grow / 28) * 28 for side in size)
    return float(width), float(height)
