"""Experiments: a plant, laws and figures put together, one module each."""
