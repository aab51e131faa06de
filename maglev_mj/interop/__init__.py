"""Other programs and input devices."""
