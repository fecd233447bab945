"""Limits of requests, connections and transfers."""
