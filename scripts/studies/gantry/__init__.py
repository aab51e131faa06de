"""Modules of teleoperation.py: a gantry moved by the joystick."""
