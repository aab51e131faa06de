"""Gymnasium environments, input devices and teleoperation."""
