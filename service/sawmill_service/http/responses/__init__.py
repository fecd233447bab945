"""Responses: downloads, pictures, arrays, conditional requests and long polls."""
