"""Calibration, identification and commissioning of a device."""
