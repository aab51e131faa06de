"""Control laws as pure functions with frozen parameters."""
