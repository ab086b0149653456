"""A vision-language model as a baseline, behind any server of OpenAI's chat protocol: vLLM, Ollama, llama.cpp."""
