"""A vision-language model as a baseline, behind any server of OpenAI's chat protocol: vLLM, Ollama, llama.cpp."""

from pipeline.evaluation.vlm.client import KEY_VARIABLE, Answer, ChatClient, Question, ServerError
from pipeline.evaluation.vlm.protocol import Prices, Usage
from pipeline.evaluation.vlm.questions import (
    Grounding,
    GroundingConfig,
    PairScores,
    RelationConfig,
    ground,
    ground_many,
    score_pairs,
)

__all__ = [
    "KEY_VARIABLE",
    "Answer",
    "ChatClient",
    "Grounding",
    "GroundingConfig",
    "PairScores",
    "Prices",
    "Question",
    "RelationConfig",
    "ServerError",
    "Usage",
    "ground",
    "ground_many",
    "score_pairs",
]
