"""Subjects of jobs: the input of a job, its output, and the effects of a job's end on the rows."""
