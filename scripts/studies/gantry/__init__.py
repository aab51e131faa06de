"""Teleoperation of a gantry by the joystick: the modules of teleoperation.py."""
