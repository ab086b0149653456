"""A vision-language model as a baseline, behind any server of OpenAI's chat protocol: vLLM, Ollama, llama.cpp."""

from pipeline.evaluation.vlm.client import KEY_VARIABLE, Answer, ChatClient, Question, ServerError
from pipeline.evaluation.vlm.grounding import Grounding, GroundingConfig, ground, ground_many
from pipeline.evaluation.vlm.protocol import Prices, Usage
from pipeline.evaluation.vlm.relations import PairScores, RelationConfig, score_pairs

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
