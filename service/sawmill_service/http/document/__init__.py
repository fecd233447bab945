"""The public OpenAPI document."""
