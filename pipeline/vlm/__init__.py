"""A vision-language model as a baseline, behind any server of OpenAI's chat protocol: vLLM, Ollama, llama.cpp."""

from pipeline.vlm.client import KEY_VARIABLE, Answer, ChatClient, Question, ServerError
from pipeline.vlm.cost import Prices, Usage
from pipeline.vlm.grounding import Grounding, GroundingConfig, ground, ground_many
from pipeline.vlm.relations import PairScores, RelationConfig, score_pairs

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
