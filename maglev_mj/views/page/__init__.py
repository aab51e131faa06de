"""A running scene as a page for any browser."""
