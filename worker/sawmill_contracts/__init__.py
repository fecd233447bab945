"""Contracts of requests and answers: pydantic models that service and worker import and that import neither.

Every boundary name carries its unit. Unknown fields are refused.
"""
