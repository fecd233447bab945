"""Workers: who claims jobs, by the built-in queue or by Celery, and the housekeeping beside them."""
