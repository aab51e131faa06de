"""The bridge to a device: its wire, a twin to try it on, and what keeps both whole."""
