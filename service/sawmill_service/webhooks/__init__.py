"""Webhooks: what happens is sent to the destinations that the settings allow, and to no others."""
