"""Gamepads and 3D mice as hands on six axes.

A device moves the target of the hand's spring.
"""
