"""A chat with an OpenAI-compatible server: requests, retries, pace and a cache of answers."""
