"""Simulated devices: firmware in Python, twin in real or virtual time, bad lines, faults."""
