"""What can be asked and what is answered: pydantic models that both sides import and that import neither.

Every boundary name carries its unit. Unknown fields are refused.
"""
