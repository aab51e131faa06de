"""What a person sees of a session, in a window or on a page."""
