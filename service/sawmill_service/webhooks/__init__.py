"""Webhooks: events are sent to the destinations that the settings allow, and to no others."""
