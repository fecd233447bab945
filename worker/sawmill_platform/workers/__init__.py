"""Workers, which claim jobs by the built-in queue or by Celery, and their housekeeping."""
