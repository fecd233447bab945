"""Common parts of all pages: language, formats, navigation, look, and shared words."""
