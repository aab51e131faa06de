"""Pose sensor: geometry and real-time solver."""
