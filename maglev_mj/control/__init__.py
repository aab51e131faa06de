"""Sampled controller: laws, time line of commands, and the loop that drives a plant."""
