"""Views of a session: window and web page."""
